"""Contact targets: what an OCP is told about the surface, the contact and the force wanted, once a period.

Three modes follow from the force wanted, the surface seen and the contact felt:

    free      no force is wanted, or no surface is within reach: the tool tracks its desired pose
    approach  a force is wanted and the tip is not at the surface: it moves there along the normal, ever slower
    push      a force is wanted and the tip is in contact: along the normal the force is controlled, not the position

The force wanted begins at `preload` when contact is made and follows the reference within `force_rate`, so that a ramp
that has begun before contact does no harm. It never exceeds `preload` and LEAD times what is felt: a tip that has
bounced off shall not be thrown back.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.contact import SMOOTH_GAP, tangential
from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.laws.bodie2021.confidence import Span, nearness
from aerotact.ports import BlockBuilder, Port

FORCE_WANTED = 0.05  # N; a smaller reference is none
FAR = 10.0  # m before the tip, where a surface is put that is not seen
SLIDING = 0.02  # m/s; where less is wanted, the friction felt goes on rather than that of sliding
LOADED = 0.5  # N; below, the friction felt says little
LEAD = 2.0  # of the force wanted before the force felt
FELT_RATE = 30.0  # rad/s, at which the friction felt is followed

CONTACT_PORTS = (
    Port("n_W", 3, "1", "W"),
    Port("offset", 1, "m"),
    Port("friction_W", 3, "1", "W"),
    Port("stiffness", 1, "N/m"),
    Port("damping", 1, "N s/m"),
    Port("rigid", 1, "1"),
    Port("f_push", 1, "N"),
    Port("push", 1, "1"),
    Port("approach", 1, "1"),
    Port("v_approach", 1, "m/s"),
    Port("near", 1, "1"),
    Port("approach_speed", 1, "m/s"),
    Port("approach_slope", 1, "1/s"),
)


@dataclass(frozen=True)
class ContactTargets:
    """What was built.

    Attributes:
        columns: values of CONTACT_PORTS at each node.
        f_tool_W: force of the surface on the tool that is expected at each node, N in W.
        telemetry: for the log.
    """

    columns: list[list[Any]]
    f_tool_W: list[Any]
    telemetry: list[tuple[Port, Any]]


def add_contact(
    b: BlockBuilder, pose: tuple[Any, Any], v_WE_d: list[Any], times: list[float], rate: float
) -> ContactTargets:
    """Declare ports, parameters and memory of the contact, and compute its targets.

    Args:
        b: of the block of targets.
        pose: measured pose of the tool, p_WE m and q_WE.
        v_WE_d: velocity of the tool that is wanted at each node, m/s.
        times: nodes, s.
        rate: Hz.
    """
    seen_n = b.measurement("n_W", 3, "1", frame="W", doc="unit normal of the surface, towards the robot")
    distance = b.measurement("surface_distance", 1, "m", doc="from the tip to the surface along the tool's axis")
    valid = b.measurement("surface_valid", 1, "1", kind="flag", doc="1 if a surface is seen")
    contact = b.measurement("contact", 1, "1", kind="flag", doc="1 if the tip is at the surface")
    normal = b.measurement("normal_force", 1, "N", doc="low-passed force of the surface on the tip along the normal")
    f_tip_W = b.measurement("f_tip_W", 3, "N", frame="W", doc="measured force of the environment on the tip")
    friction = b.measurement("friction", 1, "1", doc="estimated coefficient of friction")
    f_ref = b.reference("f_ref", 1, "N", doc="push wanted along the surface's normal; 0: none", nodes=len(times))

    stiffness = b.parameter("stiffness", 1, "N/m", 2000.0, doc="of the compliant contact predictor", lower=1.0)
    damping = b.parameter("damping", 1, "N s/m", 150.0, doc="of the compliant contact predictor", lower=0.0)
    slow = b.parameter("approach_speed", 1, "m/s", 0.004, doc="speed of approach at the surface", lower=0.0)
    slope = b.parameter("approach_slope", 1, "1/s", 1.0, doc="growth of that speed with the distance", lower=0.0)
    margin = b.parameter("approach_margin", 1, "m/s", 0.004, doc="by which the limit exceeds that speed", lower=0.0)
    fast = b.parameter("approach_limit", 1, "m/s", 0.08, doc="highest speed of approach", lower=0.0)
    reach = b.parameter("reach", 1, "m", 0.2, doc="distance within which a force is striven for", lower=0.0)
    force_rate = b.parameter("force_rate", 1, "N/s", 200.0, doc="highest rate of the force wanted", lower=0.0)
    preload = b.parameter("preload", 1, "N", 1.0, doc="force wanted when contact is made", lower=0.0)

    span = Span(
        b.parameter("d_min", 1, "m", 0.2, doc="distance up to which the impedance is that of the wall", lower=0.0),
        b.parameter("d_max", 1, "m", 0.4, doc="distance from which it is that of free flight", lower=0.0),
    )

    # the plane: far in front of the tip where none is seen
    p_WE, q_WE = pose
    z_E = so3.rotation(q_WE)[:, 2]
    known = valid > 0
    n = ca.if_else(known, seen_n, -z_E)
    gap = ca.if_else(known, -distance * ca.dot(n, z_E), FAR)

    touching = ca.logic_and(contact > 0, known)
    wanted = ca.logic_and(f_ref[0] > FORCE_WANTED, ca.logic_and(known, distance < reach))
    pushing = ca.logic_and(wanted, touching)
    approaching = ca.logic_and(wanted, ca.logic_not(touching))

    # A tip that is to leave the surface must not think itself held: the compliant plane lies where its force is felt.
    felt = ca.fmin(ca.fmax(normal / (stiffness * SMOOTH_GAP), 0.02), 30)
    depth = SMOOTH_GAP * ca.log(ca.exp(felt) - 1)
    gap = ca.if_else(touching, -depth, gap)
    offset = ca.dot(n, p_WE) - gap

    aim = b.state("f_push", 1, "N", doc="force wanted now")
    step = force_rate / rate
    start = ca.fmin(preload, f_ref[0])
    most = preload + LEAD * ca.fmax(normal, 0)
    now = ca.if_else(pushing, ca.fmin(aim, most), start)
    b.update("f_push", now + ca.fmin(ca.fmax(f_ref[0] - now, -step), step))
    speed = ca.fmin(fast, slow + slope * ca.fmax(gap, 0))

    ratio = tangential(n, f_tip_W) / ca.fmax(normal, LOADED)
    felt_W = b.state("friction_W", 3, "1", frame="W", doc="friction felt for each newton of normal force")
    felt_W = touching * (felt_W + first_order_gain(FELT_RATE, 1 / rate) * (ratio - felt_W))
    b.update("friction_W", felt_W)
    felt_W = felt_W * ca.fmin(1, friction / ca.sqrt(ca.sumsqr(felt_W) + 1e-12))

    near = ca.if_else(known, nearness(distance, span), 0)
    # While the tip approaches no contact is predicted: the plan would push harder to keep its speed into the wall.
    met = ca.logic_not(approaching)
    columns, forces = [], []
    for k, time in enumerate(times):
        reachable = force_rate * time
        f_push = wanted * ca.fmin(now + ca.fmin(ca.fmax(f_ref[k] - now, -reachable), reachable), most)
        sliding = tangential(n, v_WE_d[k])
        pace = ca.sqrt(ca.sumsqr(sliding) + 1e-12)
        moving = pace / ca.sqrt(pace**2 + SLIDING**2)
        friction_W = felt_W + moving * (-friction * sliding / pace - felt_W)
        columns.append(
            [
                n,
                offset,
                friction_W,
                met * stiffness,
                met * damping,
                pushing,
                f_push,
                wanted,
                approaching,
                speed,
                near,
                slow + margin,
                slope,
            ]
        )
        forces.append(touching * ca.if_else(wanted, f_push, ca.fmax(normal, 0)) * (n + friction_W))
    telemetry = [
        (Port("f_push", 1, "N", doc="force wanted now"), columns[0][6]),
        (Port("pushing", 1, "1", doc="1 while force is controlled", kind="flag"), pushing),
        (Port("approaching", 1, "1", doc="1 while the surface is approached", kind="flag"), approaching),
    ]
    return ContactTargets(columns, forces, telemetry)
