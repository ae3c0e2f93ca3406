"""The model with joints: MuJoCo's accelerations, the energy balance, statics, tools, derivatives, capabilities."""

import shutil
from dataclasses import replace
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest
from stepping import random_unit, rotation

from aerotact.dynamics import so3
from aerotact.dynamics.arm_kinematics import arm_kinematics
from aerotact.dynamics.model import CAPABILITIES, Model
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.dynamics.rotors import wrench_rank
from aerotact.exceptions import MissingCapability, RobotError, UnknownName
from aerotact.laws import laws
from aerotact.ports import Array
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
SPRINGS = np.deg2rad(10.0)  # suarez2020 'Compliant joint control': the spring is linear up to there
STEP = 1e-6


@pytest.fixture(scope="module", params=["dual_arm_standard", "dual_arm_long_reach"])
def arms(request: pytest.FixtureRequest) -> Multibody:
    model = model_of(load_robot(MODELS / request.param))
    assert isinstance(model, Multibody)
    return model


def _addresses(model: Multibody) -> tuple[Array, Array]:
    """Where the joints lie in qpos and qvel."""
    mj, joints = model.robot.mjmodel, list(model.bodies.indices)
    return mj.jnt_qposadr[joints], mj.jnt_dofadr[joints]


def _random(model: Multibody, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """A state within the joints' ranges, rates and external forces."""
    lower, upper = model.robot.mjmodel.jnt_range[list(model.bodies.indices)].T
    joint = rng.uniform(lower + 0.02, upper - 0.02)
    x = model.state.pack(
        {
            "p_WB": rng.normal(size=3),
            "q_WB": random_unit(rng),
            "v_WB": rng.normal(size=3),
            "w_B": rng.normal(size=3),
            "joint": joint,
            "joint_rate": rng.normal(size=model.joints),
            "servo": joint[model.passive :] + rng.uniform(-SPRINGS, SPRINGS, model.servos),
            "thrust": rng.uniform(*model.thrust_limits),
        }
    )
    return x, rng.normal(size=model.control.size), rng.normal(size=model.disturbance.size)


def _in_mujoco(model: Multibody, x: Array, u: Array, p: Array, data: mujoco.MjData) -> None:
    """mj_forward at x with the same forces; the damper's share of the servo's rate, (15), is added as plants do."""
    mj, robot, s = model.robot.mjmodel, model.robot, model.state.unpack(x)
    qpos, qvel = _addresses(model)
    servos, rotors = [j.actuator_index for j in model.compliant], [r.index for r in robot.rotors]
    data.qpos[:7], data.qvel[:6] = x[:7], x[7:13]
    data.qpos[qpos], data.qvel[qvel] = s["joint"], s["joint_rate"]
    data.act[mj.actuator_actadr[servos]], data.act[mj.actuator_actadr[rotors]] = s["servo"], s["thrust"]
    rates = model.control.unpack(u)
    data.ctrl[rotors] = s["thrust"] + model.time_constants * rates["thrust_rate"]
    data.ctrl[servos] = s["servo"] + model.servo_time_constants * rates["servo_rate"]
    data.qfrc_applied[:] = 0.0
    data.qfrc_applied[qvel[model.passive :]] = model.damping * rates["servo_rate"]
    mujoco.mj_kinematics(mj, data)
    mujoco.mj_comPos(mj, data)
    d, none = model.disturbance.unpack(p), np.zeros(3)
    torque_W = rotation(s["q_WB"]) @ d["tau_ext_B"]
    mujoco.mj_applyFT(mj, data, d["f_ext_W"], torque_W, s["p_WB"], robot.base_id, data.qfrc_applied)
    for arm in robot.arms:
        point, body = data.site_xpos[arm.tool_index].copy(), int(mj.site_bodyid[arm.tool_index])
        mujoco.mj_applyFT(mj, data, d[f"f_{arm.name}_W"], none, point, body, data.qfrc_applied)
    mujoco.mj_forward(mj, data)


def test_derivative_equals_mujoco(arms: Multibody) -> None:
    rng, mj = np.random.default_rng(0), arms.robot.mjmodel
    data = mujoco.MjData(mj)
    mj.actuator_ctrllimited[:] = False  # rates, not commands, are drawn
    _, qvel = _addresses(arms)
    servos = mj.actuator_actadr[[j.actuator_index for j in arms.compliant]]
    M = np.zeros((mj.nv, mj.nv))
    base = joints = force = 0.0
    for _ in range(200):
        x, u, p = _random(arms, rng)
        _in_mujoco(arms, x, u, p, data)
        assert data.nefc == 0
        xdot = arms.state.unpack(arms.function(x, u, p).full())
        difference = np.zeros(mj.nv)
        difference[:6] = np.concatenate([xdot["v_WB"], xdot["w_B"]]) - data.qacc[:6]
        difference[qvel] = xdot["joint_rate"] - data.qacc[qvel]
        mujoco.mj_fullM(mj, data, M)
        base = max(base, np.abs(difference[:6]).max())
        # Thousands of rad/s2 arise where shoulder axes align and only a bracket turns: relative there.
        joints = max(joints, np.abs(difference[qvel]).max() / max(1.0, np.abs(data.qacc).max()))
        force = max(force, np.abs(M @ difference).max())
        np.testing.assert_allclose(xdot["servo"], data.act_dot[servos], atol=1e-12)
    assert base < 1e-9
    assert joints < 1e-12
    assert force < 1e-11


def _energy(model: Multibody, data: mujoco.MjData, x: Array) -> float:
    """Kinetic, gravity and spring energy, from MuJoCo's kinematics and none of its dynamics, J."""
    mj, s = model.robot.mjmodel, model.state.unpack(x)
    qpos, qvel = _addresses(model)
    data.qpos[:3], data.qpos[3:7] = s["p_WB"], s["q_WB"] / np.linalg.norm(s["q_WB"])
    data.qvel[:6] = x[7:13]
    data.qpos[qpos], data.qvel[qvel] = s["joint"], s["joint_rate"]
    mujoco.mj_kinematics(mj, data)
    mujoco.mj_comPos(mj, data)
    energy, J_v, J_w = 0.0, np.zeros((3, mj.nv)), np.zeros((3, mj.nv))
    for body in range(1, mj.nbody):
        mujoco.mj_jacBodyCom(mj, data, J_v, J_w, body)
        R = data.ximat[body].reshape(3, 3)
        v, w = J_v @ data.qvel, R.T @ (J_w @ data.qvel)
        energy += 0.5 * mj.body_mass[body] * v @ v + 0.5 * w @ (mj.body_inertia[body] * w)
        energy += mj.body_mass[body] * model.robot.gravity * data.xipos[body][2]
    deflection = s["servo"] - s["joint"][model.passive :]
    return float(energy + 0.5 * (model.stiffness * deflection) @ deflection)


def test_energy_balance(arms: Multibody) -> None:
    """Its change is the work of rotors, servos and tools less what dampers take; the springs hold half of (11)."""
    rng, data = np.random.default_rng(1), mujoco.MjData(arms.robot.mjmodel)
    symbol, p_symbol = ca.SX.sym("x", arms.state.size), ca.SX.sym("p", arms.disturbance.size)
    tool_power = ca.Function("forces", [symbol, p_symbol], [arms.tool_force_torques(symbol, p_symbol)])
    for _ in range(20):
        x, u, p = _random(arms, rng)
        p[:6] = 0.0
        s, rate = arms.state.unpack(x), arms.control.unpack(u)["servo_rate"]
        xdot = arms.function(x, u, p).full().ravel()
        change = (_energy(arms, data, x + STEP * xdot) - _energy(arms, data, x - STEP * xdot)) / (2 * STEP)
        force_B, torque_B = (v.full().ravel() for v in arms.rotor_wrench(ca.DM(s["thrust"])))
        v_B, link_rate = rotation(s["q_WB"]).T @ s["v_WB"], s["joint_rate"][arms.passive :]
        spring = arms.stiffness * (s["servo"] - s["joint"][arms.passive :])
        damper = arms.damping * (rate - link_rate)
        power = force_B @ v_B + torque_B @ s["w_B"]
        power += tool_power(x, p).full().ravel() @ np.concatenate([v_B, s["w_B"], s["joint_rate"]])
        power += (spring + damper) @ rate - damper @ (rate - link_rate)
        power -= (arms.bearing_damping * s["joint_rate"]) @ s["joint_rate"]
        assert change == pytest.approx(power, rel=1e-6, abs=1e-5)
        doubled = power + spring @ (rate - link_rate)
        assert abs(change - doubled) > 1e-3  # what twice the spring's energy, (11) as printed, would give


def test_energy_is_conserved_without_dampers_and_rotors(arms: Multibody) -> None:
    """Half a second of free motion, RK4: the springs swing, the pendulum turns, the base falls and tumbles."""
    robot = arms.robot
    undamped = tuple(
        replace(arm, joints=tuple(replace(j, damping=0.0, bearing=0.0) for j in arm.joints)) for arm in robot.arms
    )
    passive = tuple(replace(j, damping=0.0) for j in robot.passive)
    free = Multibody(replace(robot, arms=undamped, passive=passive))
    none = ca.DM.zeros(free.control.size), ca.DM.zeros(free.disturbance.size)
    x = ca.SX.sym("x", free.state.size)
    f = ca.Function("f", [x], [free.derivative(x, *none)])
    h, after = 5e-4, x
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))
    many = ca.Function("step", [x], [after]).mapaccum(1000)
    rng = np.random.default_rng(9)
    start = free.state.unpack(free.hover_state.copy())
    start |= {"thrust": np.zeros(6), "w_B": rng.normal(size=3), "v_WB": rng.normal(size=3)}
    start["joint_rate"] = 2.0 * rng.normal(size=free.joints)
    x0 = free.state.pack(start)
    path = many(x0).full()
    data = mujoco.MjData(robot.mjmodel)
    energies = np.array([_energy(free, data, column) for column in path[:, ::100].T])
    before = _energy(free, data, x0)
    spring = 0.5 * (
        free.stiffness * (path[free.state.slice("servo")] - path[free.state.slice("joint")][free.passive :]).T ** 2
    )
    assert np.ptp(spring.sum(axis=1)) > 0.05  # J that come and go
    assert np.abs(energies - before).max() < 1e-8 * abs(before)


def test_hover_state_is_an_equilibrium(arms: Multibody) -> None:
    xdot = arms.function(arms.hover_state, np.zeros(arms.control.size), np.zeros(arms.disturbance.size)).full()
    assert np.abs(xdot).max() < 1e-11
    nothing = ca.DM.zeros(arms.disturbance.size)
    np.testing.assert_allclose(
        arms.holding_servo(ca.DM(arms.hover_state), nothing).full().ravel(), arms.hover_servo, atol=1e-14
    )


def test_holding_servo_holds_the_arms_under_load(arms: Multibody) -> None:
    """Spring torque equals gravity and contact: k (theta - q) = G - J' f; no torque is left on the arms."""
    rng = np.random.default_rng(2)
    x, _, p = _random(arms, rng)
    x = arms.at_rest(ca.DM(x)).full().ravel()
    p[:6] = 0.0
    held = arms.holding_servo(ca.DM(x), ca.DM(p)).full().ravel()
    x[arms.state.slice("servo")] = held
    load = (arms.gravity_torque(ca.DM(x)) - arms.tool_force_torques(ca.DM(x), ca.DM(p))[6:]).full().ravel()
    torque = arms.joint_torque(ca.DM(x), ca.DM.zeros(arms.control.size)).full().ravel()
    np.testing.assert_allclose(torque, load[arms.passive :], atol=1e-14)
    data = mujoco.MjData(arms.robot.mjmodel)
    _in_mujoco(arms, x, np.zeros(arms.control.size), p, data)
    _, qvel = _addresses(arms)
    left = (data.qfrc_actuator + data.qfrc_applied - data.qfrc_bias)[qvel[arms.passive :]]
    np.testing.assert_allclose(left, 0.0, atol=1e-13)


def test_gravity_torque_agrees_with_the_arm_alone(arms: Multibody) -> None:
    rng = np.random.default_rng(3)
    x, _, _ = _random(arms, rng)
    s = arms.state.unpack(x)
    whole = arms.gravity_torque(ca.DM(x)).full().ravel()[arms.passive :]
    for arm in arms.robot.arms:
        kinematics, own = arm_kinematics(arms.robot, arm.name), arms.arm_slice(arm.name)
        _, R_BS = kinematics.shoulder_pose(s["joint"][0] if arms.passive else 0.0)
        up = R_BS.full().T @ rotation(s["q_WB"]).T @ [0.0, 0.0, arms.robot.gravity]
        alone = kinematics.gravity_torque(ca.DM(s["joint"][arms.passive :][own]), ca.DM(up)).full().ravel()
        np.testing.assert_allclose(whole[own], alone, atol=1e-13)


def test_command_undoes_the_lag(arms: Multibody) -> None:
    x, u, _ = _random(arms, np.random.default_rng(4))
    command = arms.command(ca.DM(x), ca.DM(u))
    assert arms.commands.size == command.shape[0]
    np.testing.assert_allclose(arms.rates(ca.DM(x), command).full().ravel(), u, atol=1e-12)
    s, sent = arms.state.unpack(x), arms.commands.unpack(command.full())
    expected = (sent["servo_cmd"] - s["servo"]) / 0.05  # (17)
    np.testing.assert_allclose(arms.control.unpack(u)["servo_rate"], expected, atol=1e-12)


def test_encoders_see_deflections_and_the_pendulum(arms: Multibody) -> None:
    x, _, _ = _random(arms, np.random.default_rng(8))
    s, said = arms.state.unpack(x), {n: v.full().ravel() for n, v in arms.sensed(ca.DM(x)).items()}
    deflection = s["servo"] - s["joint"][arms.passive :]
    np.testing.assert_array_equal(said["deflection_measured"], deflection[[0, 3]])
    assert ("passive_measured" in said) == bool(arms.passive)
    if arms.passive:
        np.testing.assert_array_equal(said["passive_measured"], s["joint"][:1])


def test_tools_equal_mujoco(arms: Multibody) -> None:
    rng, robot, data = np.random.default_rng(5), arms.robot, mujoco.MjData(arms.robot.mjmodel)
    twist = np.zeros(6)
    for _ in range(10):
        x, u, p = _random(arms, rng)
        _in_mujoco(arms, x, u, p, data)
        for arm in robot.arms:
            p_WE, q_WE = (v.full().ravel() for v in arms.arm_tool_pose(ca.DM(x), arm.name))
            np.testing.assert_allclose(p_WE, data.site_xpos[arm.tool_index], atol=1e-14)
            np.testing.assert_allclose(rotation(q_WE).ravel(), data.site_xmat[arm.tool_index], atol=1e-14)
        site = robot.mjmodel.site(robot.file.robot.tool).id
        mujoco.mj_objectVelocity(robot.mjmodel, data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 0)
        v_WE, w_E = (v.full().ravel() for v in arms.tool_twist(ca.DM(x)))
        np.testing.assert_allclose(v_WE, twist[3:], atol=1e-13)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3) @ w_E, twist[:3], atol=1e-13)


def test_tool_jacobian_by_finite_differences(arms: Multibody) -> None:
    x, _, _ = _random(arms, np.random.default_rng(6))
    J = arms.tool_jacobian(ca.DM(x)).full()
    assert J.shape == (6, 6 + arms.joints)
    joint = arms.state.slice("joint")
    for column, direction in enumerate(np.eye(6 + arms.joints)):
        poses = []
        for step in (STEP, -STEP):
            moved = x.copy()
            moved[:3] += step * direction[:3]
            moved[3:7] = so3.product(ca.DM(x[3:7]), so3.exponential(ca.DM(step * direction[3:6]))).full().ravel()
            moved[joint] += step * direction[6:]
            poses.append(arms.tool_pose(ca.DM(moved)))
        linear = (poses[0][0] - poses[1][0]).full().ravel() / (2 * STEP)
        angular = so3.local(poses[1][1], poses[0][1]).full().ravel() / (2 * STEP)
        np.testing.assert_allclose(J[:, column], [*linear, *angular], atol=1e-8)


def test_derivative_on_the_manifold_and_of_an_expression(arms: Multibody) -> None:
    x, u, p = (ca.SX.sym(n, layout.size) for n, layout in zip("xup", arms.layouts, strict=True))
    dx = ca.SX.sym("dx", arms.tangent_size)
    flow = arms.derivative(arms.retract(x, dx), u, p)
    A = ca.Function("A", [x, dx, u, p], [ca.jacobian(flow, dx)])
    flow = ca.Function("f", [x, dx, u, p], [flow])
    at, rates, forces = _random(arms, np.random.default_rng(7))
    zero = np.zeros(arms.tangent_size)
    columns = [
        (flow(at, STEP * e, rates, forces) - flow(at, -STEP * e, rates, forces)).full().ravel() / (2 * STEP)
        for e in np.eye(arms.tangent_size)
    ]
    exact = A(at, zero, rates, forces).full()
    np.testing.assert_allclose(np.array(columns).T, exact, atol=1e-6 * np.abs(exact).max())
    moved = arms.retract(ca.DM(at), ca.DM(0.1 * np.arange(arms.tangent_size) / arms.tangent_size))
    back = arms.local(ca.DM(at), moved).full().ravel()
    np.testing.assert_allclose(back, 0.1 * np.arange(arms.tangent_size) / arms.tangent_size, atol=1e-13)


def test_capabilities_of_a_robot_with_arms(arms: Multibody) -> None:
    expected = {"arm", "tool", "fixed_rotors", "thrust_and_torque"} | ({"passive_joint"} if arms.passive else set())
    assert arms.capabilities == expected
    assert arms.capabilities <= set(CAPABILITIES)
    assert wrench_rank(arms.robot) == 4
    lack = "law ryll2019_pose_control needs rigid_body, six_axis_wrench, which robot 'dual_arm"
    with pytest.raises(MissingCapability, match=lack):
        laws()["ryll2019_pose_control"](arms, 250.0)


def test_unknown_arm_is_named(arms: Multibody) -> None:
    for find in (arms.arm, arms.arm_slice):
        with pytest.raises(UnknownName, match=r"unknown arm 'middle' in robot 'dual_arm.*valid: left, right"):
            find("middle")


def test_model_of_tells_bodies_apart(hexarotor: Model, tmp_path: Path) -> None:
    assert type(model_of(hexarotor.robot)) is Model
    for part in ("parts", "dual_arm_standard"):
        shutil.copytree(MODELS / part, tmp_path / part)
    toml = tmp_path / "dual_arm_standard" / "robot.toml"
    toml.write_text(
        toml.read_text().split("[[arms]]")[0] + "[sensors.imu]" + toml.read_text().split("[sensors.imu]")[1]
    )
    bare = load_robot(tmp_path / "dual_arm_standard")
    assert bare.arms == ()
    assert type(model_of(bare)) is Model


def test_tilting_rotors_with_joints_are_refused(arms: Multibody) -> None:
    tilting = load_robot(MODELS / "tilt_rotor")
    assert tilting.tilts
    both = replace(tilting, arms=arms.robot.arms)
    with pytest.raises(RobotError, match=r"tilts a rotor of a robot with arms; list fixed rotors only"):
        model_of(both)
