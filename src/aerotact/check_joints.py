"""What `check` finds out about a robot with arms or passive joints: trim, agreement with MuJoCo, limits."""

import mujoco
import numpy as np

from aerotact.dynamics.multibody import Multibody
from aerotact.dynamics.rotors import allocation
from aerotact.ports import Array
from aerotact.robot import HOVER_KEYFRAME, Robot

DEFLECTION = np.deg2rad(10.0)  # within which springs are linear, suarez2020 'Compliant joint control'
CLEARANCE = 0.02  # rad, from the stops of the joints


def joint_trim(robot: Robot) -> tuple[str, float]:
    """Activations that hold the pose of the hover keyframe, in the order of plant.xml, as text in full digits.

    Returns:
        The text, and the largest torque that the pose asks of a passive joint, N m, which must be zero.
    """
    model, data = robot.mjmodel, mujoco.MjData(robot.mjmodel)
    mujoco.mj_resetDataKeyframe(model, data, model.key(HOVER_KEYFRAME).id)
    data.qvel[:], data.qacc[:] = 0.0, 0.0
    mujoco.mj_inverse(model, data)
    base = model.jnt_dofadr[model.body_jntadr[robot.base_id]]
    R_WB = data.xmat[robot.base_id].reshape(3, 3)
    force_B, torque_B = R_WB.T @ data.qfrc_inverse[base : base + 3], data.qfrc_inverse[base + 3 : base + 6]
    wrench = np.concatenate([force_B, torque_B - np.cross(robot.p_BC, force_B)])
    activations = np.zeros(model.nu)
    activations[[r.index for r in robot.rotors]] = np.linalg.lstsq(allocation(robot), wrench, rcond=None)[0]
    for joint in (joint for arm in robot.arms for joint in arm.joints):
        torque = data.qfrc_inverse[model.jnt_dofadr[joint.index]]
        activations[joint.actuator_index] = data.qpos[model.jnt_qposadr[joint.index]] + torque / joint.stiffness
    off = [abs(data.qfrc_inverse[model.jnt_dofadr[joint.index]]) for joint in robot.passive]
    return " ".join(repr(float(a)) for a in activations), float(max(off, default=0.0))


def joint_disagreement(model: Multibody, rng: np.random.Generator, states: int) -> float:
    """Largest difference between CasADi's and MuJoCo's accelerations and actuator rates over random states.

    Joints are within their ranges and their springs' linear range, servos within their speeds. Differences of joint
    accelerations are relative to the largest acceleration: a bracket of 1e-4 kg m2 turns at thousands of rad/s2.
    """
    robot, mj = model.robot, model.robot.mjmodel
    data, joints = mujoco.MjData(mj), list(model.bodies.indices)
    qpos, qvel = mj.jnt_qposadr[joints], mj.jnt_dofadr[joints]
    servos, rotors = [j.actuator_index for j in model.compliant], [r.index for r in robot.rotors]
    activations = mj.actuator_actadr[[*servos, *rotors]]
    limited = mj.jnt_limited[joints].astype(bool)
    lower, upper = (
        np.where(limited, side, wide) for side, wide in zip(mj.jnt_range[joints].T, (-3.0, 3.0), strict=True)
    )
    worst = 0.0
    for _ in range(states):
        attitude = rng.normal(size=4)
        joint = rng.uniform(lower + CLEARANCE, upper - CLEARANCE)
        servo = joint[model.passive :] + rng.uniform(-DEFLECTION, DEFLECTION, model.servos)
        s = {
            "p_WB": rng.uniform([-2, -2, 8], [2, 2, 12]),
            "q_WB": attitude / np.linalg.norm(attitude),
            "v_WB": rng.normal(size=3),
            "w_B": 2 * rng.normal(size=3),
            "joint": joint,
            "joint_rate": rng.normal(size=model.joints),
            "servo": np.clip(servo, *model.servo_limits),
            "thrust": rng.uniform(*model.thrust_limits),
        }
        rate = rng.uniform(*model.servo_rate_limits)
        sent = np.clip(s["servo"] + model.servo_time_constants * rate, *model.servo_limits)
        thrust = rng.uniform(*model.thrust_limits)
        p = rng.normal(size=model.disturbance.size)
        data.qpos[:7], data.qvel[:6] = [*s["p_WB"], *s["q_WB"]], [*s["v_WB"], *s["w_B"]]
        data.qpos[qpos], data.qvel[qvel] = joint, s["joint_rate"]
        data.act[activations] = np.concatenate([s["servo"], s["thrust"]])
        data.ctrl[rotors], data.ctrl[servos] = thrust, sent
        _push(model, p, data)
        data.qfrc_applied[qvel[model.passive :]] += model.damping * (sent - s["servo"]) / model.servo_time_constants
        mujoco.mj_forward(mj, data)
        x = model.state.pack(s)
        u = model.rates(x, np.concatenate([thrust, sent])).full().ravel()
        found = model.state.unpack(model.function(x, u, p).full())
        scale = max(1.0, float(np.abs(data.qacc).max()))
        differences = [
            np.concatenate([found["v_WB"], found["w_B"]]) - data.qacc[:6],
            (found["joint_rate"] - data.qacc[qvel]) / scale,
            np.concatenate([found["servo"], found["thrust"]]) - data.act_dot[activations],
        ]
        worst = max(worst, float(np.abs(np.concatenate(differences)).max()))
    return worst


def _push(model: Multibody, p: Array, data: mujoco.MjData) -> None:
    """Let the external forces p act, through MuJoCo's own Jacobians."""
    mj, robot, d = model.robot.mjmodel, model.robot, model.disturbance.unpack(p)
    data.qfrc_applied[:] = 0.0
    mujoco.mj_kinematics(mj, data)
    mujoco.mj_comPos(mj, data)
    p_WB, R_WB = data.xpos[robot.base_id].copy(), data.xmat[robot.base_id].reshape(3, 3)
    mujoco.mj_applyFT(mj, data, d["f_ext_W"], R_WB @ d["tau_ext_B"], p_WB, robot.base_id, data.qfrc_applied)
    for arm in robot.arms:
        body, point = int(mj.site_bodyid[arm.tool_index]), data.site_xpos[arm.tool_index].copy()
        mujoco.mj_applyFT(mj, data, d[f"f_{arm.name}_W"], np.zeros(3), point, body, data.qfrc_applied)


def joint_limit_fault(robot: Robot, excess: float) -> str:
    """What is wrong with the arms' limits at hover, or empty.

    Args:
        robot: with arms.
        excess: times what the lag allows, beyond which a servo rate cannot be meant.
    """
    plant_xml, key = robot.folder / "plant.xml", robot.mjmodel.key(HOVER_KEYFRAME)
    for joint in (joint for arm in robot.arms for joint in arm.joints):
        angle = float(key.qpos[robot.mjmodel.jnt_qposadr[joint.index]])
        servo = float(key.ctrl[joint.actuator_index])
        for part, value, (lower, upper) in (
            (f"joint '{joint.name}': range", angle, joint.range),
            (f"actuator '{joint.actuator}': ctrlrange", servo, joint.servo),
        ):
            if not lower < value < upper:
                return f"{plant_xml}: {part} is {lower:.3g} to {upper:.3g} rad and hover needs {value:.3g}; widen it"
        torque = abs(joint.stiffness * (servo - angle))
        if torque >= joint.torque:
            return (
                f"{plant_xml}: actuator '{joint.actuator}': hover needs {torque:.3g} N m, forcerange is "
                f"{joint.torque:g}; choose another pose"
            )
        reach = (joint.servo[1] - joint.servo[0]) / joint.time_constant
        if joint.servo_rate > excess * reach:
            return (
                f"{robot.folder / 'robot.toml'}: servo_rate of '{joint.name}': {joint.servo_rate:g} rad/s is far "
                f"beyond what a lag of {joint.time_constant:g} s allows, {reach:g} rad/s; check its unit"
            )
    return ""
