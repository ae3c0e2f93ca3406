"""Intentional interaction control: observer, force sensor, impedance and direct force as one law, (22)-(26)."""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion, add_base, add_desired_tool, base_reference, numbers
from aerotact.dynamics.tilt_allocation import allocate
from aerotact.estimation.force_sensor import add_force_sensor
from aerotact.estimation.momentum_observer import add_momentum_observer, add_rotor_wrench
from aerotact.gains import with_robot_gains
from aerotact.laws.bodie2021 import confidence as trust
from aerotact.laws.bodie2021 import direct_force as direct
from aerotact.laws.bodie2021 import impedance as soft
from aerotact.ports import Block, BlockBuilder

NAME = "bodie2021_impedance_force"


def command_wrench(
    model: Model, base: BaseMotion, reference: BaseMotion, f: Any, tau: Any, f_ext: Any, tau_ext: Any
) -> Any:
    """Rotor wrench that adds the dynamics (1)-(2) to impedance and direct force: (24)-(26) with the errata.

    Args:
        model: gives mass, inertia about the centre of mass, and where that is.
        base: motion now.
        reference: motion wanted, with accelerations.
        f: force of impedance and direct control, N in B.
        tau: their torque about the base's origin, N m in B.
        f_ext: estimated force of the environment on the robot, N in B.
        tau_ext: estimated torque about the base's origin, N m in B.

    Returns:
        Force, N, and torque about the centre of mass, N m, in B, (6,). With the allocation's torques being about the
        centre of mass, p_com x (F_cmd + F_ext) of (25) about the origin becomes p_com x F_ext. The base's origin then
        obeys (7) although the centre of mass lies elsewhere: its offset is in the force, too, which the paper neglects.
    """
    robot, w = model.robot, base.w_B
    J = _constant(robot.J_C)
    p_BC, R_BW = _constant(robot.p_BC), so3.rotation(base.q_WB).T
    a_ref, dw_ref = soft.reference_acceleration(base, reference)
    gyroscopic = ca.cross(w, ca.mtimes(J, w))

    tau_star = tau + ca.mtimes(J, dw_ref) + gyroscopic
    dw = ca.mtimes(_constant(np.linalg.inv(robot.J_C)), tau_star + tau_ext - gyroscopic)
    to_com = ca.cross(dw, p_BC) + ca.cross(w, ca.cross(w, p_BC))
    weight = ca.mtimes(R_BW, ca.DM([0, 0, robot.gravity]))
    f_cmd = f + robot.mass * (a_ref + ca.cross(w, ca.mtimes(R_BW, base.v_WB)) + weight + to_com)
    return ca.vertcat(f_cmd, tau_star + ca.cross(p_BC, f_ext))


def _constant(matrix: Any) -> Any:
    """A constant whose rounding dust is no entry."""
    return ca.sparsify(ca.DM(np.where(np.abs(matrix) < 1e-15 * np.abs(matrix).max(), 0.0, matrix)))


def bodie2021_impedance_force(model: Model, rate: float) -> Block:
    """The whole law: wrench observer (5)-(6), force filter, variable impedance (7)-(12), direct force (13)-(26).

    With m_wall = m_free = J_v = 1 it is the plain PD controller of Table V, with f_ref = 0 impedance alone.

    Raises:
        MissingCapability: the robot lacks a tool, a force/torque sensor, tilting rotors, or the six-axis wrench.
    """
    model.require(["six_axis_wrench", "tilt", "tool", "force_torque"], f"law {NAME}")
    b = BlockBuilder(NAME, "bodie2021", rate, "variable axis-selective impedance with direct force control (3)-(26)")
    base, desired = add_base(b, model), add_desired_tool(b, model)
    wanted = ca.fmax(b.reference("f_ref", 1, "N", doc="force on the surface along the push; none if negative"), 0)
    surface = _add_surface(b)
    compliant = _add_span(b, "d", 0.2, 0.4, "distance of the surface", "(8), (15)")
    trusted = _add_span(b, "e", 0.15, 0.25, "tool error along the push", "(16)")
    impedance, gains = soft.add_impedance(b), direct.add_force_gains(b)
    share = b.parameter(
        "tilt_share", 1, "1", 0.5, doc="weight of turning a rotor beside changing its thrust", lower=1e-3
    )

    wrench, tilt = add_rotor_wrench(b, model)
    f_ext, tau_ext_C = add_momentum_observer(b, model, rate, base, wrench)
    f_push, _ = add_force_sensor(b, model, rate, base.q_WB)
    p_BC, p_BE, axis_B = ca.DM(model.robot.p_BC), ca.DM(model.robot.p_BE), ca.DM(model.robot.R_BE[:, 2])
    tau_ext = tau_ext_C + ca.cross(p_BC, f_ext)

    R_WB = so3.rotation(base.q_WB)
    reference = base_reference(model, desired)
    errors = soft.tracking_errors(base, reference)
    near = trust.surface_nearness(surface, compliant)
    push_W = trust.push_direction(b, surface, ca.mtimes(R_WB, axis_B))
    u = ca.mtimes(R_WB.T, push_W)
    tool_error = ca.dot(base.p_WB + ca.mtimes(R_WB, p_BE) - desired.p_WE, push_W)
    confidence = trust.confidence(b, surface, near, tool_error, wanted > 0, trusted, rate)

    Lambda = direct.selection(u, confidence)
    f_imp, tau_imp = soft.impedance_wrench(
        impedance, errors, soft.mass_ratio(impedance, axis_B, near), Lambda, p_BE, f_ext, tau_ext
    )
    measured = ca.dot(u, f_push)
    limit = direct.approach_limit(
        gains,
        surface.distance,
        ca.dot(u, impedance.D_lin * u),
        ca.dot(push_W, reference.v_WB),
        ca.dot(u, impedance.K_lin * errors.e_p),
        measured,
    )
    push = direct.Push(wanted, measured, confidence, near, limit)
    integral = b.state("force_integral", 1, "N s", doc="integral of the force error, gated by the confidence")
    f_dir = u * direct.direct_force(gains, push, integral)

    f, tau = f_imp + f_dir, tau_imp + ca.cross(p_BE, f_dir)
    command = command_wrench(model, base, reference, f, tau, f_ext, tau_ext)
    allocation = allocate(model, command, tilt, share)
    shortfall = ca.dot(u, (command - allocation.reachable)[0:3])
    b.update("force_integral", direct.next_integral(gains, push, integral, shortfall, 1.0 / rate))

    hover = model.robot
    b.output("thrust_cmd", allocation.thrust, "N", doc="thrust commands", default=numbers(hover.hover_thrust))
    b.output("tilt_cmd", allocation.tilt, "rad", doc="tilt commands", default=numbers(hover.hover_tilt))
    b.output("confidence_factor", confidence, "1", doc="lambda, (17)")
    b.output("compliance_factor", near, "1", doc="c, (8)")
    b.output("f_dir_B", f_dir, "N", frame="B", doc="direct force command, (21)")
    b.output("f_imp_B", f_imp, "N", frame="B", doc="impedance force command, (23)")
    b.output("f_push_B", f_push, "N", frame="B", doc="filtered force of the robot on the environment")
    b.output("f_ext_W", ca.mtimes(R_WB, f_ext), "N", frame="W", doc="force of the environment on the robot, (5)")
    b.output("tau_ext_B", tau_ext_C, "N m", frame="B", doc="torque of the environment about the centre of mass, (5)")
    b.limit_with(actuator_limiter(model, rate))
    return with_robot_gains(b.build(), model.robot)


def _add_surface(b: BlockBuilder) -> trust.Surface:
    """Ports of perception."""
    return trust.Surface(
        distance=b.measurement(
            "surface_distance", 1, "m", doc="of the surface from the tip along the tool's axis", default=(10.0,)
        ),
        normal_W=b.measurement("n_W", 3, "1", frame="W", doc="the surface's unit normal, towards the robot"),
        valid=b.measurement("surface_valid", 1, "1", kind="flag", doc="1 if a surface is seen"),
    )


def _add_span(b: BlockBuilder, name: str, low: float, high: float, doc: str, where: str) -> trust.Span:
    """The two ends of a ramp."""
    return trust.Span(
        low=b.parameter(f"{name}_min", 1, "m", low, doc=f"{doc} up to which the factor is one, {where}", lower=0.0),
        high=b.parameter(f"{name}_max", 1, "m", high, doc=f"{doc} from which it is zero, {where}", lower=0.0),
    )
