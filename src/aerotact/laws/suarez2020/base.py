"""Position and velocity control of the platform, the outer two of suarez2020's four loops, and all four in one.

    position, P:    v_c = v_r + K_p (p_r - p) + K_swing dq0/dt d, K_p's part at most v_max; d below
    velocity, PID:  a_c = a_r + K_v e + K_vi int e + K_vd de/dt,    e = v_c - v
    force:          F   = m (a_c + g e_z) - sum of the tools' forces, tilted by at most tilt_max

F gives the lift, its part along z_B, and the attitude: z_B along F, then the yaw. The torque tau_r compensates the
arms' reaction ('General control framework'), see `reaction`. K_swing damps a passive joint: the base follows the way d
on which a positive rate carries what hangs on it. The paper gives the structure and no gains.
"""

from typing import Any

import casadi as ca
import mujoco
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion, add_base, hover_poses
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.attitude import (
    NEEDS,
    SOURCE,
    AttitudeReference,
    Pid,
    add_attitude_loops,
    add_servos,
    finish,
    limited,
)
from aerotact.ports import Array, Block, BlockBuilder
from aerotact.robot import HOVER_KEYFRAME

VELOCITY_LOOP = Pid("K_v", "m/s", (2.5, 2.5, 4.0), (0.9, 0.9, 1.5), (0.0, 0.0, 0.0), 3.0)
LEAST_LIFT = 0.3  # of the weight: the vertical force is never less, so that the attitude is defined


def reaction(model: Multibody, joint: Any, lift: Any, f_tools_B: Any) -> Any:
    """Torque, N m in B, that keeps the base from turning under the arms' weight and the tools' forces.

    Quasi-static: the base's acceleration is what lift and tools give it, and no joint moves but the passive ones, which
    follow. With A, E of `Multibody.held_arms` and f the tools' generalised forces,

        A_vv a_B = [0, 0, lift] + (E f)_v,    tau = A_tv a_B - (E f)_t.

    Args:
        model: of the robot.
        joint: angles, rad, (m,).
        lift: force of the rotors along z_B, N.
        f_tools_B: of the environment on each tool, N in B, (3, arms).
    """
    A, passed = model.held_arms(joint)
    pushed = ca.DM.zeros(6)
    for number, arm in enumerate(model.robot.arms):
        tool, f_B = model.bodies.site(arm.tool_index, joint), f_tools_B[:, number]
        pushed += ca.vertcat(f_B, ca.cross(tool.p_BS, f_B))
        pushed += ca.mtimes(passed, ca.mtimes(tool.J_v[:, : model.passive].T, f_B))
    a_B = ca.mtimes(ca.inv(A[0:3, 0:3]), ca.vertcat(0, 0, lift) + pushed[0:3])
    return ca.mtimes(A[3:6, 0:3], a_B) - pushed[3:6]


def swing_directions(model: Multibody) -> Array:
    """Unit vectors (3, passive) in B: on which way a positive rate of each passive joint carries what hangs on it."""
    mj, data = model.robot.mjmodel, mujoco.MjData(model.robot.mjmodel)
    mujoco.mj_resetDataKeyframe(mj, data, mj.key(HOVER_KEYFRAME).id)
    mujoco.mj_forward(mj, data)
    R_WB, ways = data.xmat[model.robot.base_id].reshape(3, 3), []
    for joint in model.robot.passive:
        hanging = data.subtree_com[mj.jnt_bodyid[joint.index]] - data.xanchor[joint.index]
        way = R_WB.T @ np.cross(data.xaxis[joint.index], hanging)
        way[np.abs(way) < 0.1 * np.abs(way).max()] = 0.0
        ways.append(way / np.linalg.norm(way))
    return np.array(ways).reshape(-1, 3).T


def attitude_along(force_W: Any, yaw: Any) -> Any:
    """Attitude whose z is along a force with a positive vertical part, by the shortest turn from the yaw's."""
    z = force_W / ca.sqrt(ca.sumsqr(force_W))
    tilt = so3.unit(ca.vertcat(1 + z[2], -z[1], z[0], 0))
    return so3.product(tilt, ca.vertcat(ca.cos(yaw / 2), 0, 0, ca.sin(yaw / 2)))


def add_position_loops(
    b: BlockBuilder, model: Multibody, rate: float, base: BaseMotion
) -> tuple[AttitudeReference, Any]:
    """Ports, states and equations of the position and velocity loops.

    Returns:
        What they ask of the inner loops; and joint angles, joint rates (None without a passive joint), p_r, v_r, a_r,
        yaw_r as they enter.
    """
    robot, at, arms = model.robot, hover_poses(model), len(model.robot.arms)
    joint = b.measurement("joint", model.joints, "rad", doc="joint angles", default=tuple(model.hover_joint))
    p_r = b.reference("p_WB_r", 3, "m", frame="W", doc="position of the base", default=at["p_WB"])
    v_r = b.reference("v_WB_r", 3, "m/s", frame="W", doc="velocity of the base")
    a_r = b.reference("a_WB_r", 3, "m/s^2", frame="W", doc="acceleration of the base")
    yaw_r = b.reference("yaw_r", 1, "rad", doc="yaw of the base")
    f_tools_r = b.reference("f_tools_W_r", 3 * arms, "N", frame="W", doc="force of the environment on each arm's tool")
    K_p = b.parameter("K_p", 3, "1/s", (1.4, 1.4, 2.0), frame="W", doc="gain of the position's error", lower=0.0)
    fastest = b.parameter("v_max", 1, "m/s", 1.5, doc="highest speed that the position's error asks for", lower=0.0)
    cutoff = b.parameter(
        "v_cutoff", 1, "rad/s", 30.0, doc="low-pass of the derivative of the velocity's error", lower=0.0
    )
    tilt_max = b.parameter("tilt_max", 1, "rad", 0.45, doc="largest tilt that is asked for", lower=0.0)
    share = b.parameter("reaction", 1, "1", 1.0, doc="share of the arms' reaction that is compensated", lower=0.0)

    R_WB = so3.rotation(base.q_WB)
    v_c = v_r + limited(K_p * (p_r - base.p_WB), fastest)
    joint_rate = None
    if model.passive:
        joint_rate = b.measurement("joint_rate", model.joints, "rad/s", doc="rates of the joint angles")
        K_swing = b.parameter("K_swing", model.passive, "m", 0.15, doc="speed of the base per rate of a passive joint")
        way_W = ca.mtimes(R_WB, ca.mtimes(ca.DM(swing_directions(model)), K_swing * joint_rate[: model.passive]))
        v_c += ca.vertcat(way_W[0:2], 0)
    a_c = a_r + VELOCITY_LOOP.add(b, rate, v_c - base.v_WB, "W", cutoff)

    f_tools_W = ca.reshape(f_tools_r, 3, arms)
    weight = robot.mass * robot.gravity
    F_W = robot.mass * a_c + ca.vertcat(0, 0, weight) - ca.sum2(f_tools_W)
    up = ca.fmax(F_W[2], LEAST_LIFT * weight)
    F_W = ca.vertcat(limited(F_W[0:2], up * ca.tan(tilt_max)), up)
    lift = ca.dot(F_W, R_WB[:, 2])
    tau_B = share * reaction(model, joint, lift, ca.mtimes(R_WB.T, f_tools_W))
    seen = (joint, joint_rate, p_r, v_r, a_r, yaw_r)
    return AttitudeReference(lift, attitude_along(F_W, yaw_r), ca.DM.zeros(3), tau_B), seen


def with_arms(model: Model, who: str) -> Multibody:
    """The model, which must have arms."""
    model.require((*NEEDS, "arm"), who)
    if not isinstance(model, Multibody):
        raise MissingCapability(f"{who} needs arm, which robot '{model.robot.name}' ({model.robot.folder}) lacks")
    return model


def suarez2020_position(model: Model, rate: float) -> Block:
    """Position and velocity loops alone, to be flown outside of suarez2020_attitude, whose references they give.

    Raises:
        MissingCapability: no arms, or rotors that do not fit.
    """
    arms = with_arms(model, "law suarez2020_position")
    b = BlockBuilder("suarez2020_position", SOURCE, rate, "position and velocity loops, 'Aerial platform'")
    r, _ = add_position_loops(b, arms, rate, add_base(b, arms))
    weight = arms.robot.mass * arms.robot.gravity
    at = hover_poses(arms)
    b.output("lift_r", r.lift, "N", frame="B", doc="force along z_B", default=(weight,))
    b.output("q_WB_r", r.q_WB, "1", frame="W", doc="attitude", kind="quaternion", default=at["q_WB"])
    b.output("tau_B_r", r.tau_B, "N m", frame="B", doc="torque against the arms' reaction")
    b.output("w_B_r", r.w_B, "rad/s", frame="B", doc="angular velocity of the attitude, zero")
    return with_robot_gains(b.build(), arms.robot)


def suarez2020_base(model: Model, rate: float) -> Block:
    """Position, velocity, attitude and rate loops with the arms' reaction compensated and the swing damped.

    Raises:
        MissingCapability: no arms, or rotors that do not fit.
    """
    arms = with_arms(model, "law suarez2020_base")
    b = BlockBuilder("suarez2020_base", SOURCE, rate, "four nested loops of the platform, 'Aerial platform'")
    base = add_base(b, arms)
    reference, _ = add_position_loops(b, arms, rate, base)
    servo = add_servos(b, arms)
    add_attitude_loops(b, arms, rate, base.q_WB, base.w_B, reference)
    finish(b, arms, rate, servo)
    return with_robot_gains(b.build(), arms.robot)


LAWS = {"suarez2020_base": suarez2020_base, "suarez2020_position": suarez2020_position}
