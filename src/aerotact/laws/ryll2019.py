"""ryll2019: 6D interaction control with aerial robots: the flying end-effector paradigm (IJRR 38(9), 2019).

An admittance filter turns the wrench on the tool into a reference pose of the tool, (27)-(28); the reference moves to
the base, (29)-(30); full-pose inverse dynamics with wrench compensation tracks it, (11)-(17) and (26). Where the
printed equations cannot stand, docs/errata.md says what is implemented and why.

The paper's body frame R has its origin at the centre of mass; here the base's origin may lie elsewhere, so that motions
are moved between the base's origin B and the centre of mass C.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import admittance, so3
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.admittance import ToolMotion
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import (
    BaseMotion,
    add_base,
    add_desired_tool,
    base_reference,
    com_motion,
    hover_poses,
    numbers,
)
from aerotact.dynamics.rotors import least_thrust_inverse
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder

SOURCE = "ryll2019"


@dataclass(frozen=True)
class PoseGains:
    """Diagonals of K_p1 (1/s) and K_p2 (1/s2) of (14), K_R1 (1/s) and K_R2 (1/s2) of (17), each (3,)."""

    K_p1: Any
    K_p2: Any
    K_R1: Any
    K_R2: Any


# equations


def pose_accelerations(model: Model, base: BaseMotion, reference: BaseMotion, gains: PoseGains) -> tuple[Any, Any]:
    """Accelerations wanted, v of (13): (14) for the centre of mass, m/s2 in W, and (15)-(17), rad/s2 in B.

    The feed-forward of (17) is the reference's angular acceleration as the base sees it, R'R_r dw_r - w x R'R_r w_r
    (the derivative of the second term of (16)), so that the errors obey de_w/dt = -K_R1 e_w - K_R2 e_R at any error.
    """
    p_WC, v_WC, _ = com_motion(model, base)
    p_WC_r, v_WC_r, a_WC_r = com_motion(model, reference)
    a_WC = a_WC_r + gains.K_p1 * (v_WC_r - v_WC) + gains.K_p2 * (p_WC_r - p_WC)

    R_BBr = ca.mtimes(so3.rotation(base.q_WB).T, so3.rotation(reference.q_WB))
    e_R = 0.5 * so3.vee(R_BBr.T - R_BBr)
    w_r_B = ca.mtimes(R_BBr, reference.w_B)
    e_w = base.w_B - w_r_B
    dw_r_B = ca.mtimes(R_BBr, reference.dw_B) - ca.cross(base.w_B, w_r_B)
    return a_WC, dw_r_B - gains.K_R1 * e_w - gains.K_R2 * e_R


def inverse_dynamics(model: Model, base: BaseMotion, a_WC: Any, dw_B: Any, f_ext_W: Any, tau_ext_B: Any) -> Any:
    """Thrusts, N, that give the accelerations wanted against the wrench of the environment: (11)-(12) and (26).

    The wrench enters divided by mass and inertia, as its place in (26), a sum of accelerations, demands (errata). With
    more than six rotors the thrusts are those of least sum of squares.
    """
    robot = model.robot
    J = ca.sparsify(ca.DM(np.where(np.abs(robot.J_C) < 1e-15, 0.0, robot.J_C)))
    f_W = robot.mass * (a_WC + ca.DM([0, 0, robot.gravity])) - f_ext_W
    f_B = ca.mtimes(so3.rotation(base.q_WB).T, f_W)
    tau_B = ca.mtimes(J, dw_B) + ca.cross(base.w_B, ca.mtimes(J, base.w_B)) - tau_ext_B
    return ca.mtimes(ca.DM(least_thrust_inverse(robot)), ca.vertcat(f_B, tau_B))


def ahead(motion: ToolMotion, h: float) -> ToolMotion:
    """The motion h seconds later at constant linear and angular acceleration in W."""
    turn = h * motion.w_WE + h * h / 2 * motion.dw_WE
    return ToolMotion(
        p_WE=motion.p_WE + h * motion.v_WE + h * h / 2 * motion.a_WE,
        q_WE=so3.product(so3.exponential(turn), motion.q_WE),
        v_WE=motion.v_WE + h * motion.a_WE,
        w_WE=motion.w_WE + h * motion.dw_WE,
        a_WE=motion.a_WE,
        dw_WE=motion.dw_WE,
    )


# ports


def _add_external_wrench(b: BlockBuilder) -> tuple[Any, Any]:
    """Estimated wrench that (26) compensates."""
    return (
        b.measurement("f_ext_W", 3, "N", frame="W", doc="force of the environment on the robot"),
        b.measurement("tau_ext_B", 3, "N m", frame="B", doc="torque of the environment on the robot about its COM"),
    )


def _add_pose_gains(b: BlockBuilder) -> PoseGains:
    """Gains of (14) and (17)."""
    return PoseGains(
        K_p1=b.parameter("K_p1", 3, "1/s", 4.0, frame="W", doc="gain of the velocity error, (14)"),
        K_p2=b.parameter("K_p2", 3, "1/s^2", 4.0, frame="W", doc="gain of the position error, (14)"),
        K_R1=b.parameter("K_R1", 3, "1/s", 8.0, frame="B", doc="gain of the angular velocity error, (17)"),
        K_R2=b.parameter("K_R2", 3, "1/s^2", 16.0, frame="B", doc="gain of the attitude error, (17)"),
    )


def _add_admittance(b: BlockBuilder, model: Model, rate: float) -> ToolMotion:
    """Ports, states and equations (27)-(28): the tool's reference now.

    The state holds the reference; at the first step it starts as the desired motion. A jump of the desired pose is a
    jump of the filter's spring, not of the reference.
    """
    at = hover_poses(model)
    tip, level = at["p_WE"], at["q_WE"]
    f_tool_W = b.measurement("f_tool_W", 3, "N", frame="W", doc="force of the environment on the tool")
    tau_tool_W = b.measurement("tau_tool_W", 3, "N m", frame="W", doc="torque of the environment on the tool's tip")

    desired = add_desired_tool(b, model)
    law, dead_force, dead_torque = admittance.add_parameters(b)
    wrench_W = ca.vertcat(
        admittance.dead_zone(f_tool_W, dead_force),
        admittance.dead_zone(tau_tool_W, dead_torque),
    )

    started = b.state("started", 1, "1", kind="flag", doc="1 after the first step")
    p = b.state("p_WE_r", 3, "m", frame="W", doc="reference position of the tool", default=tip)
    q = b.state("q_WE_r", 4, "1", frame="W", doc="reference attitude of the tool", kind="quaternion", default=level)
    v = b.state("v_WE_r", 3, "m/s", frame="W", doc="reference velocity of the tool")
    w = b.state("w_WE_r", 3, "rad/s", frame="W", doc="reference angular velocity of the tool")
    running = started > 0
    held = ToolMotion(
        p_WE=ca.if_else(running, p, desired.p_WE),
        q_WE=ca.if_else(running, q, desired.q_WE),
        v_WE=ca.if_else(running, v, desired.v_WE),
        w_WE=ca.if_else(running, w, desired.w_WE),
        a_WE=None,
        dw_WE=None,
    )
    a_WE, dw_WE = admittance.acceleration(law, desired, held, wrench_W)
    reference = ToolMotion(held.p_WE, held.q_WE, held.v_WE, held.w_WE, a_WE, dw_WE)

    period = 1.0 / rate
    later = admittance.advance(law, desired, ahead(desired, period), reference, wrench_W, period)
    b.update("started", 1)
    b.update("p_WE_r", later.p_WE)
    b.update("q_WE_r", later.q_WE)
    b.update("v_WE_r", later.v_WE)
    b.update("w_WE_r", later.w_WE)
    return reference


def _add_thrust(
    b: BlockBuilder, model: Model, base: BaseMotion, wrench: tuple[Any, Any], reference: BaseMotion
) -> None:
    """Gains and output of the inner loop: the thrust commands that track the reference against the wrench."""
    a_WC, dw_B = pose_accelerations(model, base, reference, _add_pose_gains(b))
    thrust = inverse_dynamics(model, base, a_WC, dw_B, *wrench)
    b.output("thrust_cmd", thrust, "N", doc="thrust commands", default=numbers(model.robot.hover_thrust))


# blocks


def pose_control(model: Model, rate: float) -> Block:
    """Full-pose control with wrench compensation, (11)-(17) and (26), without the admittance filter.

    Raises:
        MissingCapability: rotors tilt, or the robot cannot exert force and torque independently.
    """
    b = BlockBuilder("ryll2019_pose_control", SOURCE, rate, "full-pose inverse dynamics (11)-(17), (26)")
    model.require(["rigid_body", "fixed_rotors", "six_axis_wrench"], "law ryll2019_pose_control")
    base, wrench = add_base(b, model), _add_external_wrench(b)
    at = hover_poses(model)
    reference = BaseMotion(
        p_WB=b.reference("p_WB_r", 3, "m", frame="W", doc="reference position of the base", default=at["p_WB"]),
        q_WB=b.reference("q_WB_r", 4, "1", frame="W", doc="reference attitude", kind="quaternion", default=at["q_WB"]),
        v_WB=b.reference("v_WB_r", 3, "m/s", frame="W", doc="reference velocity of the base"),
        w_B=b.reference("w_B_r", 3, "rad/s", frame="B", doc="reference angular velocity, in the reference's own axes"),
        a_WB=b.reference("a_WB_r", 3, "m/s^2", frame="W", doc="reference acceleration of the base"),
        dw_B=b.reference("dw_B_r", 3, "rad/s^2", frame="B", doc="its derivative in the reference's own axes"),
    )
    _add_thrust(b, model, base, wrench, reference)
    b.limit_with(actuator_limiter(model, rate))
    return with_robot_gains(b.build(), model.robot)


def admittance_filter(model: Model, rate: float) -> Block:
    """Reference of the tool from its desired motion and the wrench on it, (27)-(28) behind the paper's dead zone.

    Raises:
        MissingCapability: the robot has no tool.
    """
    b = BlockBuilder("ryll2019_admittance_filter", SOURCE, rate, "admittance of the tool (27)-(28)")
    model.require(["tool"], "law ryll2019_admittance_filter")
    reference = _add_admittance(b, model, rate)
    _output_tool_pose(b, reference)
    b.output("w_WE_r", reference.w_WE, "rad/s", frame="W", doc="reference angular velocity of the tool")
    b.output("a_WE_r", reference.a_WE, "m/s^2", frame="W", doc="reference acceleration of the tool")
    b.output("dw_WE_r", reference.dw_WE, "rad/s^2", frame="W", doc="reference angular acceleration of the tool")
    return with_robot_gains(b.build(), model.robot)


def ryll2019_admittance(model: Model, rate: float) -> Block:
    """The whole law: admittance filter (27)-(28), reference of the base (29)-(30), pose control (11)-(17), (26).

    Raises:
        MissingCapability: rotors tilt, the robot has no tool, or cannot exert force and torque independently.
    """
    b = BlockBuilder("ryll2019_admittance", SOURCE, rate, "admittance law of the flying end-effector (11)-(30)")
    model.require(["rigid_body", "fixed_rotors", "six_axis_wrench", "tool"], "law ryll2019_admittance")
    base, wrench = add_base(b, model), _add_external_wrench(b)
    tool = _add_admittance(b, model, rate)
    _add_thrust(b, model, base, wrench, base_reference(model, tool))
    _output_tool_pose(b, tool)
    b.limit_with(actuator_limiter(model, rate))
    return with_robot_gains(b.build(), model.robot)


def _output_tool_pose(b: BlockBuilder, tool: ToolMotion) -> None:
    """Outputs that both admittance blocks share."""
    b.output("p_WE_r", tool.p_WE, "m", frame="W", doc="reference position of the tool")
    b.output("q_WE_r", tool.q_WE, "1", frame="W", doc="reference attitude of the tool", kind="quaternion")
    b.output("v_WE_r", tool.v_WE, "m/s", frame="W", doc="reference velocity of the tool")


LAWS = {
    "ryll2019_admittance": ryll2019_admittance,
    "ryll2019_admittance_filter": admittance_filter,
    "ryll2019_pose_control": pose_control,
}
