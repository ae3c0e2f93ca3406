"""wrench_observer: the wrench of the environment on the robot, from accelerometer, gyroscope and rotor speeds.

ryll2019 (18)-(25): an acceleration-based observer of the force, a momentum-based observer of the torque, and their
wrench moved to the tool. Signs and frames follow docs/errata.md.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder


def first_order_gain(bandwidth: Any, period: float) -> Any:
    """Share of the way that dx/dt = bandwidth (u - x) goes in `period` seconds with u held; in [0, 1) for any rate.

    Args:
        bandwidth: rad/s, any shape.
        period: s.
    """
    return 1 - ca.exp(-period * bandwidth)


def specific_force_at_com(model: Model, specific_force_B: Any, w_B: Any, dw_B: Any) -> Any:
    """Specific force, m/s2 in B, at the centre of mass from that at the IMU: rigid-body transport along p_BC - p_BI.

    Args:
        model: gives the two places.
        specific_force_B: at the IMU, m/s2.
        w_B: angular velocity, rad/s.
        dw_B: angular acceleration, rad/s2.
    """
    p_IC_B = ca.sparsify(ca.DM(model.robot.p_BC - model.robot.p_BI))
    return specific_force_B + ca.cross(dw_B, p_IC_B) + ca.cross(w_B, ca.cross(w_B, p_IC_B))


def wrench_at_tool(model: Model, q_WB: Any, f_W: Any, tau_B: Any) -> tuple[Any, Any]:
    """Wrench on the tool's tip from that at the centre of mass, ryll2019 (25) with (18).

    Args:
        model: gives p_BE and p_BC.
        q_WB: attitude of the base.
        f_W: force, N in W.
        tau_B: torque about the centre of mass, N m in B.

    Returns:
        f_tool_W, N, and tau_tool_W, N m about the tip; both in W.
    """
    R_WB = so3.rotation(q_WB)
    p_CE_W = ca.mtimes(R_WB, ca.DM(model.robot.p_BE - model.robot.p_BC))
    return f_W, ca.mtimes(R_WB, tau_B) - ca.cross(p_CE_W, f_W)


def wrench_observer(model: Model, rate: float) -> Block:
    """Wrench observer of ryll2019 at `rate` Hz.

    Force, (19): the residual R_WB (m s_C - f_rotors), s_C being the specific force at the centre of mass, through a
    first-order filter of bandwidth L. Torque, (23)-(24): the residual of the angular momentum J w through a first-order
    filter of bandwidth K_I; only the change of the momentum enters, so no acceleration is differentiated.
    Filters are discretised exactly, so that a constant wrench is approached as exp(-L t) and exp(-K_I t) at any rate.

    While `calibrate` is 1 (contact-free hover) the running mean of both residuals is learnt; while it is 0 that offset
    is held and taken from the tool's wrench, not from f_ext_W and tau_ext_B, which law (26) is to compensate whole
    (ryll2019, Practical Implementation). Each rise of `calibrate` starts a new mean.

    Forces and torques are those of the environment on the robot. Without a tool, the base's origin takes its place.

    Raises:
        MissingCapability: the robot is no rigid body.
    """
    model.require(["rigid_body"], "estimator wrench_observer")
    robot, period = model.robot, 1.0 / rate
    b = BlockBuilder(
        "wrench_observer", "ryll2019", rate, "external wrench from specific force, momentum and rotor thrusts (18)-(25)"
    )
    hover = tuple(float(v) for v in robot.hover_thrust)
    f_hat = b.state("f_ext_W", 3, "N", frame="W", doc="estimated force")
    tau_hat = b.state("tau_ext_B", 3, "N m", frame="B", doc="estimated torque about the centre of mass")
    momentum_before = b.state("momentum_B", 3, "N m s", frame="B", doc="angular momentum one step ago")
    torque_before = b.state("torque_B", 3, "N m", frame="B", doc="known torque one step ago")
    started = b.state("started", 1, "1", kind="flag", doc="1 after the first step")
    f_offset = b.state("f_offset_W", 3, "N", frame="W", doc="learnt offset of the force")
    tau_offset = b.state("tau_offset_B", 3, "N m", frame="B", doc="learnt offset of the torque")
    samples = b.state("samples", 1, "1", doc="samples in the offset's mean")
    f_low = b.state("f_tool_W", 3, "N", frame="W", doc="filtered force on the tool")
    tau_low = b.state("tau_tool_W", 3, "N m", frame="W", doc="filtered torque on the tool")

    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion", doc="attitude of the base")
    w_B = b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base")
    specific_force_B = b.measurement(
        "specific_force_B", 3, "m/s^2", frame="B", doc="at the IMU, bias removed", default=(0.0, 0.0, robot.gravity)
    )
    thrust = b.measurement("thrust_measured", model.rotors, "N", doc="actual thrusts", default=hover)
    tilt = None
    if model.tilts:
        level = tuple(float(v) for v in robot.hover_tilt)
        tilt = b.measurement("tilt_measured", model.tilts, "rad", doc="actual tilt angles", default=level)
    calibrate = b.reference("calibrate", 1, "1", kind="flag", doc="1 in contact-free hover: learn the offset")

    L = b.parameter("L", 3, "rad/s", 10.0, doc="bandwidth of the force observer, (19)", frame="W")
    K_I = b.parameter("K_I", 3, "rad/s", 10.0, doc="bandwidth of the torque observer, (23)", frame="B")
    low_pass = b.parameter("low_pass", 1, "Hz", 20.0, doc="cut-off of the tool's wrench")

    # torque, (21)-(24): what the momentum gained beyond what rotors and gyroscopic torque explain
    J = ca.sparsify(ca.DM(np.where(np.abs(robot.J_C) < 1e-15, 0.0, robot.J_C)))
    f_rotors_B, tau_rotors_B = model.rotor_wrench(thrust, tilt)
    momentum = ca.mtimes(J, w_B)
    torque = tau_rotors_B - ca.cross(w_B, momentum)
    gained = (momentum - momentum_before) * rate - (torque + torque_before) / 2
    tau_residual = ca.if_else(started > 0, gained, 0)
    tau_next = tau_hat + first_order_gain(K_I, period) * (tau_residual - tau_hat)

    # force, (19) with the errata's sign
    dw_B = ca.mtimes(ca.DM(np.linalg.inv(robot.J_C)), torque + tau_next)
    s_C_B = specific_force_at_com(model, specific_force_B, w_B, dw_B)
    f_residual = ca.mtimes(so3.rotation(q_WB), robot.mass * s_C_B - f_rotors_B)
    f_next = f_hat + first_order_gain(L, period) * (f_residual - f_hat)

    # offset
    learning = ca.logic_and(calibrate > 0, started > 0)
    count = samples * learning + 1
    share = learning / count
    f_offset_next = f_offset + share * (f_residual - f_offset)
    tau_offset_next = tau_offset + share * (tau_residual - tau_offset)

    # tool, (25)
    f_tool, tau_tool = wrench_at_tool(model, q_WB, f_next - f_offset_next, tau_next - tau_offset_next)
    smooth = first_order_gain(2 * np.pi * low_pass, period)
    f_low_next = f_low + smooth * (f_tool - f_low)
    tau_low_next = tau_low + smooth * (tau_tool - tau_low)

    b.update("f_ext_W", f_next)
    b.update("tau_ext_B", tau_next)
    b.update("momentum_B", momentum)
    b.update("torque_B", torque)
    b.update("started", 1)
    b.update("f_offset_W", f_offset_next)
    b.update("tau_offset_B", tau_offset_next)
    b.update("samples", count * learning)
    b.update("f_tool_W", f_low_next)
    b.update("tau_tool_W", tau_low_next)
    b.output("f_ext_W", f_next, "N", frame="W", doc="force on the robot, offset included")
    b.output("tau_ext_B", tau_next, "N m", frame="B", doc="torque on the robot about its COM, offset included")
    b.output("f_tool_W", f_low_next, "N", frame="W", doc="force on the tool, offset removed")
    b.output("tau_tool_W", tau_low_next, "N m", frame="W", doc="torque on the tool's tip, offset removed")
    return with_robot_gains(b.build(), robot)


ESTIMATORS = {"wrench_observer": wrench_observer}
