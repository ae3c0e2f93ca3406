"""The reduced predictor: MuJoCo with locked arms, the whole robot at rest, energy, limits."""

from itertools import product
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq
from stepping import random_unit, rotation

from aerotact.dynamics import so3
from aerotact.dynamics.actuators import SPIN, TILT, reference_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.dynamics.reduced import Reduced, predictor_of, reduced_of
from aerotact.exceptions import UnknownName
from aerotact.ports import Array
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
LOCK = 1e9  # kg m2, on the joints of arms that are to stand still


@pytest.fixture(
    scope="module",
    params=[
        ("dual_arm_standard", ["left"]),
        ("dual_arm_standard", None),
        ("dual_arm_long_reach", ["left"]),
        ("dual_arm_long_reach", None),
    ],
    ids=lambda p: f"{p[0]}-{'left' if p[1] else 'both'}",
)
def reduced(request: pytest.FixtureRequest) -> Reduced:
    name, arms = request.param
    model = predictor_of(model_of(load_robot(MODELS / name)), arms)
    assert isinstance(model, Reduced)
    return model


def _random(model: Reduced, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    x = {
        "p_WB": rng.normal(size=3),
        "q_WB": random_unit(rng),
        "v_WB": rng.normal(size=3),
        "w_B": rng.normal(size=3),
        "joint": rng.uniform(*model.joint_limits),
        "force": rng.normal(size=1),
    }
    if model.passive:
        x |= {"passive": rng.uniform(-1, 1, model.passive), "passive_rate": rng.normal(size=model.passive)}
    u = {"thrust": rng.uniform(20, 60, 1), "torque": rng.normal(size=3)}
    n_W = rng.normal(size=3)
    p = np.concatenate([rng.normal(size=6), n_W / np.linalg.norm(n_W)])
    return model.state.pack(x), model.control.pack(u), p


def _locked(model: Reduced, x: Array, u: Array, p: Array) -> Array:
    """Accelerations [a_W; dw_B; passive] by MuJoCo, with joints of arms too heavy to turn."""
    mj, robot = load_robot(model.robot.folder).mjmodel, model.robot
    joints = list(model.full.bodies.indices)
    qpos, qvel = mj.jnt_qposadr[joints], mj.jnt_dofadr[joints]
    mj.dof_armature[qvel[model.passive :]] = LOCK
    data, s, c = mujoco.MjData(mj), model.state.unpack(x), model.control.unpack(u)
    data.qpos[:7], data.qvel[:6] = x[:7], x[7:13]
    data.qpos[qpos] = ca.DM(ca.evalf(model.all_joints(ca.DM(x)))).full().ravel()
    if model.passive:
        data.qvel[qvel[: model.passive]] = s["passive_rate"]
    mujoco.mj_kinematics(mj, data)
    mujoco.mj_comPos(mj, data)
    d, R, none = model.disturbance.unpack(p), rotation(s["q_WB"]), np.zeros(3)
    force, torque = d["f_ext_W"] + R[:, 2] * c["thrust"], R @ (d["tau_ext_B"] + c["torque"])
    mujoco.mj_applyFT(mj, data, force, torque, s["p_WB"], robot.base_id, data.qfrc_applied)
    tool = model.full.arm(model.arms[0]).tool_index
    point, body = data.site_xpos[tool].copy(), int(mj.site_bodyid[tool])
    mujoco.mj_applyFT(mj, data, s["force"] * d["n_W"], none, point, body, data.qfrc_applied)
    mujoco.mj_forward(mj, data)
    # Springs push on joints that cannot move; their actuators leave base and pendulum alone.
    return np.concatenate([data.qacc[:6], data.qacc[qvel[: model.passive]]])


def test_accelerations_equal_mujocos_with_locked_arms(reduced: Reduced) -> None:
    x, u, p = (ca.SX.sym(n, size) for n, size in zip("xup", (layout.size for layout in reduced.layouts), strict=True))
    motion = ca.Function("motion", [x, u, p], [ca.vertcat(*reduced.motion(x, u, p))])
    rng = np.random.default_rng(0)
    for _ in range(50):
        case = _random(reduced, rng)
        found, expected = motion(*case).full().ravel(), _locked(reduced, *case)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)  # LOCK lets the arms yield by 1e-8


def test_arms_held_over_an_interval_change_nothing_at_its_start(reduced: Reduced) -> None:
    x, u, p = _random(reduced, np.random.default_rng(1))
    held = reduced.derivative(ca.DM(x), ca.DM(u), ca.DM(p), reduced.arms_at(ca.SX(ca.DM(x))))
    np.testing.assert_allclose(
        ca.evalf(held).full(), ca.evalf(reduced.derivative(ca.SX(ca.DM(x)), ca.DM(u), ca.DM(p))).full(), atol=1e-12
    )


def test_energy_changes_by_the_power_of_thrust_torque_and_bearing(reduced: Reduced) -> None:
    """With the arms still; the energy is that of the library's mass matrix of the whole robot."""
    full = reduced.full
    x, u = ca.SX.sym("x", reduced.state.size), ca.SX.sym("u", reduced.control.size)
    p = ca.DM(reduced.disturbance.pack({"n_W": [0, 0, 1]}))
    s, c = reduced.state.split(x), reduced.control.split(u)
    q, arms = reduced.all_joints(x), ca.SX.zeros(full.servos)
    rate = ca.vertcat(s["passive_rate"], arms) if reduced.passive else arms
    R = so3.rotation(s["q_WB"])
    v_B = ca.mtimes(R.T, s["v_WB"])
    M, nu = full.bodies.mass_matrix(q), ca.vertcat(v_B, s["w_B"], rate)
    height = ca.dot(R[2, :].T, ca.vertcat(M[5, 1], M[3, 2], M[4, 0])) + reduced.robot.mass * s["p_WB"][2]
    energy = ca.dot(nu, ca.mtimes(M, nu)) / 2 + reduced.robot.gravity * height
    gained = ca.jtimes(energy, x, reduced.derivative(x, u, p))
    power = c["thrust"] * v_B[2] + ca.dot(c["torque"], s["w_B"])
    if reduced.passive:
        power -= float(full.bearing_damping[0]) * s["passive_rate"] ** 2
    balance = ca.Function("balance", [x, u], [gained, power])
    rng = np.random.default_rng(2)
    for _ in range(20):
        state, control, _ = _random(reduced, rng)
        state[reduced.state.slice("force")] = 0.0
        found, expected = balance(state, control)
        assert float(found) == pytest.approx(float(expected), abs=1e-9)


def test_stopping_the_arms_keeps_the_momentum_of_base_and_passive_joint(reduced: Reduced) -> None:
    """By the mass matrix of the whole robot; the base then moves as measured while the arms do."""
    full, rng = reduced.full, np.random.default_rng(7)
    x = ca.SX.sym("x", reduced.state.size)
    joint_rate = ca.SX.sym("rate", reduced.joints)
    k, stopped = 6 + reduced.passive, reduced.stopped(x, joint_rate)
    rates = ca.SX.zeros(full.servos)
    rates[reduced.working.tolist()] = joint_rate

    def momentum(state: ca.SX, arms: ca.SX) -> ca.SX:
        s = reduced.state.split(state)
        v_B = ca.mtimes(so3.rotation(s["q_WB"]).T, s["v_WB"])
        passive = (s["passive_rate"],) if reduced.passive else ()
        M = full.bodies.mass_matrix(reduced.all_joints(state))
        return ca.mtimes(M[:k, :], ca.vertcat(v_B, s["w_B"], *passive, arms))

    u = ca.vertcat(ca.DM(reduced.hover_control[:4]), joint_rate, 0)
    slope = reduced.derivative(stopped, u, ca.DM(reduced.disturbance.pack({"n_W": [0, 0, 1]})))
    check = ca.Function(
        "check",
        [x, joint_rate],
        [momentum(x, rates) - momentum(stopped, 0 * rates), slope[0:3] - x[reduced.state.slice("v_WB")]],
    )
    for _ in range(10):
        gaps = check(_random(reduced, rng)[0], rng.normal(size=reduced.joints))
        for gap in gaps:
            np.testing.assert_allclose(gap.full(), 0.0, atol=1e-12)


def test_servo_angles_hold_the_whole_robot_at_rest_against_a_force(reduced: Reduced) -> None:
    """In the quasi-static limit the predictor and the compliant robot are the same."""
    full, rng = reduced.full, np.random.default_rng(3)
    for _ in range(10):
        n_W = rng.normal(size=3)
        n_W /= np.linalg.norm(n_W)
        lower, upper = reduced.joint_limits
        parts = {"force": 2.0, "joint": rng.uniform(lower, upper)}

        def moment(angle: float, parts: dict[str, object] = parts, n_W: Array = n_W) -> float:
            x = reduced.state.pack({**parts, "passive": [angle]})  # type: ignore[dict-item]
            return float(ca.evalf(reduced.loads(ca.SX(ca.DM(x)), ca.DM(n_W)))[0])

        if reduced.passive:
            parts["passive"] = [brentq(moment, -1.4, 1.4, xtol=1e-14)]
        x = reduced.state.pack(parts)  # type: ignore[arg-type]
        joint = ca.evalf(reduced.all_joints(ca.DM(x))).full().ravel()
        servo = full.hover_servo.copy()
        whole = full.state.pack({"joint": joint, "servo": servo})
        level = full.holding_servo(ca.DM(whole), ca.DM.zeros(full.disturbance.size)).full().ravel()
        level[reduced.working] = ca.evalf(reduced.holding_servo(ca.SX(ca.DM(x)), ca.DM(n_W))).full().ravel()
        whole = full.state.pack({"joint": joint, "servo": level})
        hand = f"f_{reduced.arms[0]}_W"
        p, u = ca.SX.sym("p", 6), ca.DM.zeros(full.control.size)
        d = {"f_ext_W": p[0:3], "tau_ext_B": p[3:6], hand: ca.DM(2.0 * n_W)}
        outside = ca.vertcat(*[d.get(port.name, ca.DM.zeros(3)) for port in full.disturbance])
        motion = ca.vertcat(*full.motion(ca.DM(whole), u, outside))
        affine = ca.Function("affine", [p], [motion, ca.jacobian(motion, p)])
        free, slope = (v.full() for v in affine(np.zeros(6)))
        wrench = np.linalg.solve(slope[:6], -free[:6, 0])
        np.testing.assert_allclose(affine(wrench)[0].full(), 0.0, atol=1e-8)


def test_every_thrust_and_torque_within_the_limits_leaves_the_rotors_in_their_range(reduced: Reduced) -> None:
    lower, upper = reduced.full.thrust_limits
    corners = product(
        *zip(*reduced.thrust_limits, strict=True),
        *zip(reduced.hover_torque - reduced.torque_limits, reduced.hover_torque + reduced.torque_limits, strict=True),
    )
    for corner in corners:
        rotors = reduced.mixer @ np.array(corner)
        force, torque = reduced.full.rotor_wrench(ca.DM(rotors))
        np.testing.assert_allclose([force[2], *ca.vertsplit(torque)], np.reshape(corner, (4, 1, 1)), atol=1e-9)
        assert (rotors >= lower - 1e-9).all()
        assert (rotors <= upper + 1e-9).all()


def test_tool_moves_as_its_jacobian_says(reduced: Reduced) -> None:
    x = ca.SX.sym("x", reduced.state.size)
    p_WE, q_WE = reduced.tool_pose(x)
    columns = [*range(13, 13 + reduced.passive), *range(*reduced.state.slice("joint").indices(reduced.state.size))]
    both = ca.Function("both", [x], [ca.jacobian(p_WE, x)[:, columns], reduced.tool_jacobian(x), q_WE])
    at, _, _ = _random(reduced, np.random.default_rng(4))
    found, expected, q = both(at)
    np.testing.assert_allclose(found.full(), expected.full(), atol=1e-12)
    assert float(ca.norm_2(q)) == pytest.approx(1.0)
    hover = reduced.full.hover_tool
    for ours, whole in zip(reduced.hover_tool, hover, strict=True):
        np.testing.assert_allclose(ours, whole, atol=1e-12)


def test_tool_twist_is_that_of_the_whole_robot_with_its_arms_still(reduced: Reduced) -> None:
    at, _, _ = _random(reduced, np.random.default_rng(6))
    s = reduced.state.unpack(at)
    joint = ca.evalf(reduced.all_joints(ca.SX(ca.DM(at)))).full().ravel()
    rate = np.zeros(reduced.full.joints)
    if reduced.passive:
        rate[: reduced.passive] = s["passive_rate"]
    known = {name: s[name] for name in ("p_WB", "q_WB", "v_WB", "w_B")}
    whole = reduced.full.state.pack({**known, "joint": joint, "joint_rate": rate})
    for ours, theirs in zip(
        reduced.tool_twist(ca.SX(ca.DM(at))), reduced.full.tool_twist(ca.SX(ca.DM(whole))), strict=True
    ):
        np.testing.assert_allclose(ca.evalf(ours).full(), ca.evalf(theirs).full(), atol=1e-12)


def test_limiter_keeps_what_it_sends_within_its_limits(reduced: Reduced) -> None:
    block = reference_limiter(reduced, 50.0)
    rng, z = np.random.default_rng(5), block.state.default
    for scale in (0.1, 10.0, 1e6):
        for _ in range(20):
            wanted = reduced.commands.default + scale * rng.normal(size=reduced.commands.size)
            wanted[1:5] = 0.0 if scale == 1e6 else wanted[1:5]
            before = z[: reduced.full.servos]
            after, sent = (v.full().ravel() for v in block.step(z, wanted, [], []))
            out = reduced.commands.unpack(sent)
            assert np.isfinite(sent).all()
            assert reduced.thrust_limits[0] <= out["lift_r"] <= reduced.thrust_limits[1]
            assert np.linalg.norm(out["q_WB_r"]) == pytest.approx(1.0)
            assert np.arccos(np.clip(rotation(out["q_WB_r"])[2, 2], -1, 1)) <= TILT + 1e-6
            assert np.abs(out["w_B_r"]).max() <= SPIN
            assert (np.abs(out["tau_B_r"] - reduced.hover_torque) <= reduced.torque_limits + 1e-12).all()
            rate = (out["servo_r"] - before) / reduced.full.servo_time_constants
            assert (np.abs(rate) <= reduced.full.servo_rate_limits[1] + 1e-9).all()
            z = after


def test_a_robot_without_arms_predicts_itself() -> None:
    model = Model(load_robot(MODELS / "tilt_hex"))
    assert predictor_of(model) is model
    with pytest.raises(UnknownName, match="arm 'left'"):
        predictor_of(model, ["left"])


def test_unknown_arm_is_an_error(reduced: Reduced) -> None:
    assert isinstance(reduced.full, Multibody)
    with pytest.raises(UnknownName, match="third"):
        reduced_of(reduced.full, ["third"])
    assert reduced_of(reduced.full, ["right", "left"]).joints == 8
