"""The symbolic model: MuJoCo's accelerations, the power balance, derivatives on the manifold, capabilities."""

from dataclasses import replace

import casadi as ca
import mujoco
import numpy as np
import pytest
from stepping import random_state, rotation

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model, quaternion_from_matrix
from aerotact.dynamics.rotors import allocation
from aerotact.exceptions import InputError, MissingCapability

STEP, TOLERANCE = 1e-6, 1e-5


def _rigid(model: Model, tilt: np.ndarray) -> mujoco.MjModel:
    """The robot's plant.xml with its hinges welded at these angles and its whole mass in the base."""
    robot = model.robot
    spec = mujoco.MjSpec.from_file(str(robot.folder / "plant.xml"))
    spec.delete(spec.key("hover"))
    for t, angle in zip(robot.tilts, tilt, strict=True):
        joint = spec.joint(t.joint)
        turn, quat = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, joint.axis, angle)
        for servo in [a for a in spec.actuators if a.target == t.joint]:
            spec.delete(servo)
        body = joint.parent
        spec.delete(joint)
        axes = spec.compile().body(body.name).quat
        mujoco.mju_mulQuat(quat, axes, turn)
        body.alt.type, body.quat = mujoco.mjtOrientation.mjORIENTATION_QUAT, quat
    for body in spec.bodies:
        body.explicitinertial, body.mass, body.inertia = True, 0.0, np.zeros(3)
    base = spec.body(robot.file.robot.base)
    base.mass, base.ipos, J = robot.mass, robot.p_BC, robot.J_C
    base.fullinertia = [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]
    return spec.compile()


def test_derivative_equals_mujoco(model: Model) -> None:
    rng, robot = np.random.default_rng(4), model.robot
    worst = 0.0
    for _ in range(100 if not model.tilts else 20):
        x, f_W, tau_B = random_state(model, rng), rng.normal(size=3), rng.normal(size=3)
        s = model.state.unpack(x)
        rigid = _rigid(model, s.get("tilt", np.zeros(0)))
        data = mujoco.MjData(rigid)
        indices = [rigid.actuator(r.actuator).id for r in robot.rotors]
        activations = rigid.actuator_actadr[indices]
        command = rng.uniform(*model.thrust_limits)
        data.qpos[:7], data.qvel[:3], data.qvel[3:6] = x[:7], s["v_WB"], s["w_B"]
        data.act[activations], data.ctrl[indices] = s["thrust"], command
        data.xfrc_applied[robot.base_id] = np.concatenate([f_W, rotation(s["q_WB"]) @ tau_B])
        mujoco.mj_forward(rigid, data)
        turning = rng.normal(size=model.tilts)
        u = np.concatenate([turning, (command - s["thrust"]) / model.time_constants])
        xdot = model.function(x, u, np.concatenate([f_W, tau_B])).full().ravel()
        expected = np.concatenate([data.qacc[:6], turning, data.act_dot[activations]])
        worst = max(worst, np.abs(xdot[7:] - expected).max())
    assert worst < 1e-10


def test_command_is_what_causes_the_rates(model: Model) -> None:
    rng = np.random.default_rng(5)
    x, u = random_state(model, rng), rng.normal(size=model.control.size)
    sent = model.command(ca.DM(x), ca.DM(u))
    np.testing.assert_allclose(model.rates(ca.DM(x), sent).full().ravel(), u, atol=1e-12)
    s, commands, rates = model.state.unpack(x), model.commands.unpack(sent.full()), model.control.unpack(u)
    lags = {"thrust": model.time_constants, "tilt": model.tilt_time_constants}
    for name in (port.name for port in model.actuators):
        expected = s[name] + lags[name] * rates[f"{name}_rate"]
        np.testing.assert_allclose(commands[f"{name}_cmd"], expected, atol=1e-12)


def test_power_balance(model: Model) -> None:
    rng, robot = np.random.default_rng(5), model.robot

    def energy(x: np.ndarray) -> float:
        s = model.state.unpack(x)
        R_WB = rotation(s["q_WB"])
        v_WC = s["v_WB"] + R_WB @ np.cross(s["w_B"], robot.p_BC)
        height = (s["p_WB"] + R_WB @ robot.p_BC)[2]
        kinetic = 0.5 * robot.mass * v_WC @ v_WC + 0.5 * s["w_B"] @ robot.J_C @ s["w_B"]
        return float(kinetic + robot.mass * robot.gravity * height)

    for _ in range(20):
        x, p = random_state(model, rng), rng.normal(size=6)
        s = model.state.unpack(x)
        xdot = model.function(x, np.zeros(model.control.size), p).full().ravel()
        change = (energy(x + STEP * xdot) - energy(x - STEP * xdot)) / (2 * STEP)
        R_WB = rotation(s["q_WB"])
        v_WC = s["v_WB"] + R_WB @ np.cross(s["w_B"], robot.p_BC)
        wrench = allocation(robot, s.get("tilt")) @ s["thrust"]
        power = (R_WB @ wrench[:3] + p[:3]) @ v_WC + (wrench[3:] + p[3:]) @ s["w_B"]
        assert change == pytest.approx(power, abs=1e-5)


def test_hover_state_is_an_equilibrium(model: Model) -> None:
    xdot = model.function(model.hover_state, np.zeros(model.control.size), np.zeros(6)).full()
    assert np.abs(xdot).max() < 1e-12


def test_retract_undoes_local(model: Model) -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        a, b = ca.DM(random_state(model, rng)), ca.DM(random_state(model, rng))
        dx = model.local(a, b)
        assert dx.shape == (model.tangent_size, 1)
        reached = model.retract(a, dx).full().ravel()
        reached[3:7] *= np.sign(reached[3:7] @ b.full().ravel()[3:7])
        np.testing.assert_allclose(reached, b.full().ravel(), atol=1e-12)


def test_derivative_of_the_dynamics_on_the_manifold(model: Model) -> None:
    x, u, p = (ca.SX.sym(n, layout.size) for n, layout in zip("xup", model.layouts, strict=True))
    dx = ca.SX.sym("dx", model.tangent_size)
    flow = model.derivative(model.retract(x, dx), u, p)
    jacobian = ca.Function("A", [x, dx, u, p], [ca.jacobian(flow, dx)])
    flow = ca.Function("f", [x, dx, u, p], [flow])
    rng = np.random.default_rng(7)
    at, zero = random_state(model, rng), np.zeros(model.tangent_size)
    rates, wrench = rng.normal(size=model.control.size), rng.normal(size=6)
    differences = [
        (flow(at, STEP * e, rates, wrench) - flow(at, -STEP * e, rates, wrench)).full().ravel() / (2 * STEP)
        for e in np.eye(model.tangent_size)
    ]
    np.testing.assert_allclose(jacobian(at, zero, rates, wrench).full(), np.array(differences).T, atol=TOLERANCE)


def test_tool_jacobian_by_finite_differences(model: Model) -> None:
    rng = np.random.default_rng(8)
    x = random_state(model, rng)
    symbol = ca.SX.sym("x", model.state.size)
    jacobian = ca.Function("J", [symbol], [model.tool_jacobian(symbol)])(x).full()
    pose = ca.Function("tool", [symbol], list(model.tool_pose(symbol)))
    assert jacobian.shape == (6, 6)
    for column, direction in enumerate(np.eye(6)):
        moved = []
        for step in (STEP, -STEP):
            q_WB = so3.product(ca.DM(x[3:7]), so3.exponential(ca.DM(step * direction[3:])))
            moved.append(pose(np.concatenate([x[:3] + step * direction[:3], q_WB.full().ravel(), x[7:]])))
        linear = (moved[0][0] - moved[1][0]).full().ravel() / (2 * STEP)
        angular = so3.local(moved[1][1], moved[0][1]).full().ravel() / (2 * STEP)
        np.testing.assert_allclose(jacobian[:, column], np.concatenate([linear, angular]), atol=TOLERANCE)


def test_tool_twist_is_the_jacobian_times_the_base_twist(model: Model) -> None:
    x = random_state(model, np.random.default_rng(9))
    symbol = ca.SX.sym("x", model.state.size)
    function = ca.Function("t", [symbol], [model.tool_jacobian(symbol), ca.vertcat(*model.tool_twist(symbol))])
    jacobian, twist = (v.full() for v in function(x))
    np.testing.assert_allclose(jacobian @ x[7:13], twist.ravel(), atol=1e-12)


def test_quaternion_from_matrix_at_any_angle() -> None:
    for angle in (0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi):
        q = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * np.array([0.0, 0.6, 0.8])])
        np.testing.assert_allclose(quaternion_from_matrix(rotation(q)), q, atol=1e-12)


def test_missing_capability_names_robot_and_lack(hexarotor: Model) -> None:
    upright = tuple(replace(r, axis_B=np.array([0.0, 0.0, 1.0])) for r in hexarotor.robot.rotors)
    flat = Model(replace(hexarotor.robot, rotors=upright, has_tool=False))
    assert flat.capabilities == {"fixed_rotors", "rigid_body", "thrust_and_torque"}
    with pytest.raises(
        MissingCapability,
        match=r"law x needs six_axis_wrench.*tilt_hex.*it has: fixed_rotors, rigid_body, thrust_and_torque",
    ):
        flat.require(["six_axis_wrench"], "law x")


def test_capabilities(model: Model, tilting: Model) -> None:
    expected = {"rigid_body", "six_axis_wrench", "thrust_and_torque", "tool", "tilt" if model.tilts else "fixed_rotors"}
    expected |= {"force_torque"} if model.robot.force_torque else set()
    assert model.capabilities == expected
    # At hover the groups of this robot push upwards only: what makes the wrench six-dimensional is that they tilt.
    fixed = replace(tilting.robot, rotors=tuple(replace(r, tilt=None) for r in tilting.robot.rotors))
    assert "six_axis_wrench" not in Model(replace(fixed, hover_tilt=np.zeros(0))).capabilities


def test_layouts_of_tilting_rotors(tilting: Model) -> None:
    assert [p.name for p in tilting.state] == ["p_WB", "q_WB", "v_WB", "w_B", "tilt", "thrust"]
    assert [p.name for p in tilting.control] == ["tilt_rate", "thrust_rate"]
    assert [p.name for p in tilting.commands] == ["thrust_cmd", "tilt_cmd"]
    assert (
        tilting.tilt_limits[0].shape == tilting.tilt_rate_limits[1].shape == tilting.tilt_time_constants.shape == (6,)
    )
    with pytest.raises(InputError, match="rotor_wrench: no tilt angles; valid: 6 angles of 'tilt_rotor'"):
        tilting.rotor_wrench(ca.DM.zeros(6))
