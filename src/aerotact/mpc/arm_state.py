"""Arm state: what a reduced predictor starts from, from the sensors of the joints and the modelled servos.

Joint angles are the modelled servo angle less the deflection, which an encoder measures or the static load explains.
The deflections beyond the load of gravity tell the force on the tool, suarez2020 (25): of all forces that explain them
the likeliest, by damped least squares that expect friction across the normal. They are taken less what they are while
no force is wanted: biases of the encoders and the air's push.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.reduced import Reduced
from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.ports import BlockBuilder

_DAMPING = 1e-5  # m2, of the least squares
_ACROSS = 0.1  # variance of a force across the normal, that along it being 1: what friction makes likely
_CONVERGED = 3  # fixed-point steps from servo to joint angles


@dataclass(frozen=True)
class ArmState:
    """What was found.

    Attributes:
        x: state of the predictor, (nx,).
        force: along the normal, N, filtered.
        pushing: 1 from contact on while a force is wanted; touched: whether that began before.
        f_ext_W, tau_ext_B: wrench on the base besides the tool's force.
        servo: modelled servo angles of the working arms.
    """

    x: Any
    force: Any
    pushing: Any
    touched: Any
    f_ext_W: Any
    tau_ext_B: Any
    servo: Any


def add_arm_state(b: BlockBuilder, model: Reduced, rate: float, n_W: Any, wanted: Any) -> ArmState:
    """Declare measurements, parameters and memory, and compute the state.

    Args:
        b: of the block of targets; the modelled servo angles are added last, by `add_servo`.
        model: the predictor.
        rate: Hz.
        n_W: unit normal of the surface, (3,).
        wanted: 1 while a force is wanted.
    """
    full = model.full
    base = ca.vertcat(
        b.measurement("p_WB", 3, "m", frame="W", doc="position of the base"),
        b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion"),
        b.measurement("v_WB", 3, "m/s", frame="W", doc="velocity of the base"),
        b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base"),
    )
    f_all = b.measurement("f_ext_W", 3, "N", frame="W", doc="force of the environment on the robot")
    tau_all = b.measurement("tau_ext_B", 3, "N m", frame="B", doc="its torque about the base's origin")
    swing = _swing(b, model, rate) if model.passive else ()

    encoded, deflection = _encoders(b, model)
    servo = b.measurement("servo", full.servos, "rad", doc="modelled servo angles")[model.working.tolist()]
    force_before = b.state("force", 1, "N", doc="force along the normal one period ago")

    def state(joint: Any, force: Any) -> Any:
        return ca.vertcat(base, *swing, joint, force)

    load = b.state("load", 1, "N", doc="force that the state had one period ago")
    joint = servo
    for _ in range(_CONVERGED):
        joint = servo - model.joint_torque(state(joint, load), n_W) / ca.DM(model.stiffness)
    force = ca.SX(1, 1)
    if encoded:
        joint = ca.SX(joint)
        joint[encoded] = servo[encoded] - deflection
        static = model.joint_torque(state(joint, 0), n_W)[encoded] / ca.DM(model.stiffness[encoded])
        beyond = deflection - static
        slow = b.parameter("tare", 1, "rad/s", 0.5, doc="bandwidth of what deflects the joints at rest", lower=0.0)
        tare = b.state("tare", len(encoded), "rad", doc="deflection beyond gravity's while no force is wanted")
        b.update("tare", tare + (1 - wanted) * first_order_gain(slow, 1 / rate) * (beyond - tare))
        felt = ca.DM(model.stiffness[encoded]) * (beyond - tare)
        J = model.tool_jacobian(state(joint, 0))[:, [model.passive + i for i in encoded]]
        likely = ca.mtimes(_ACROSS * ca.SX.eye(3) + (1 - _ACROSS) * ca.mtimes(n_W, n_W.T), J)
        f_W = -ca.mtimes(likely, ca.solve(ca.mtimes(J.T, likely) + _DAMPING * ca.SX.eye(len(encoded)), felt))
        smooth = b.parameter("force_filter", 1, "Hz", 5.5, doc="cut-off of the force on the tool", lower=0.0)
        share = first_order_gain(2 * math.pi * smooth, 1 / rate)
        force = wanted * (force_before + share * (ca.dot(n_W, f_W) - force_before))
    b.update("force", force)
    touch = b.parameter("touch", 1, "N", 0.25, doc="force from which there is contact", lower=0.0)
    touched = b.state("contact", 1, "1", kind="flag", doc="1 from contact on while a force is wanted") > 0
    pushing = ca.logic_and(wanted, ca.logic_or(touched, force > touch))
    b.update("contact", pushing)
    b.update("load", pushing * force)
    x = model.stopped(state(joint, pushing * force), _rate(b, model, rate, joint))
    f_ext, tau_ext = _rest(b, model, rate, x, f_all, tau_all, n_W)
    return ArmState(x, force, pushing, touched, f_ext, tau_ext, servo)


def _encoders(b: BlockBuilder, model: Reduced) -> tuple[list[int], Any]:
    """Instrumented joints of the first working arm, by their place in `joint`, and their measured deflections."""
    entry = model.robot.file.sensors.deflection
    if entry is None:
        return [], None
    measured = b.measurement(
        "deflection_measured", len(entry.joints), "rad", doc="servo less joint angles of the instrumented joints"
    )
    names = [joint.name for joint in model.full.arm(model.arms[0]).joints]
    chosen = [i for i, name in enumerate(entry.joints) if name in names]
    return [names.index(entry.joints[i]) for i in chosen], measured[chosen]


def _rate(b: BlockBuilder, model: Reduced, rate: float, joint: Any) -> Any:
    """Rates of the working arms' joints over the last period; none in the first."""
    before = b.state("joint", model.joints, "rad", doc="joint angles one period ago")
    seen = b.state("moved", 1, "1", kind="flag", doc="1 after the first period") > 0
    b.update("joint", joint)
    b.update("moved", 1)
    return ca.if_else(seen, (joint - before) * rate, 0)


def _swing(b: BlockBuilder, model: Reduced, rate: float) -> Sequence[Any]:
    """Angles and rates of the passive joints: the rate is that of the last period, moved on by half of one."""
    angle = b.measurement("passive_measured", model.passive, "rad", doc="angles of the passive joints")
    before = b.state("passive", model.passive, "rad", doc="angles one period ago")
    slope_before = b.state("passive_slope", model.passive, "rad/s", doc="mean rates of the period before")
    known = b.state("swings", 1, "1", doc="periods that were seen, up to two")
    slope = ca.if_else(known > 0, (angle - before) * rate, 0)
    b.update("passive", angle)
    b.update("passive_slope", slope)
    b.update("swings", ca.fmin(known + 1, 2))
    return angle, slope + ca.if_else(known > 1, (slope - slope_before) / 2, 0)


def _rest(b: BlockBuilder, model: Reduced, rate: float, x: Any, f_all: Any, tau_all: Any, n_W: Any) -> tuple[Any, Any]:
    """Wrench on the base besides the tool's: what is observed less the tool's force through the observer's filter."""
    bandwidth = b.parameter("observer", 1, "rad/s", 1.0, doc="bandwidth with which f_ext_W is observed", lower=0.0)
    before = b.state("tool_wrench", 6, "1", doc="force of the surface on the tool behind that filter, W and B")
    s = model.state.split(x)
    R_WB = so3.rotation(s["q_WB"])
    lever = ca.mtimes(R_WB.T, model.tool_positions(x)[0:3] - s["p_WB"])
    f_W = s["force"] * n_W
    known = ca.vertcat(f_W, ca.cross(lever, ca.mtimes(R_WB.T, f_W)))
    low = before + first_order_gain(bandwidth, 1 / rate) * (known - before)
    b.update("tool_wrench", low)
    return f_all - low[0:3], tau_all - low[3:6]
