"""The law of ryll2019: error dynamics, closed loops on the symbolic model, printed equations that cannot stand."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import ClosedLoop, Runner, random_state, random_unit, rotation

from aerotact.dynamics import so3
from aerotact.dynamics.admittance import ToolMotion
from aerotact.dynamics.model import Model
from aerotact.estimation.wrench_observer import wrench_observer
from aerotact.exceptions import MissingCapability
from aerotact.laws import LawBuilder
from aerotact.laws.ryll2019 import (
    BaseMotion,
    PoseGains,
    admittance_filter,
    base_reference,
    inverse_dynamics,
    pose_accelerations,
    pose_control,
    ryll2019_admittance,
)
from aerotact.ports import Array

RATE = 500.0
GAINS = {"K_p1": 8.0, "K_p2": 16.0, "K_R1": 20.0, "K_R2": 100.0}
OBSERVER = {"L": 10.0, "K_I": 10.0, "low_pass": 20.0}


@pytest.fixture(scope="module", params=["octorotor", "tilt_hex"])
def model(request: pytest.FixtureRequest, models: dict[str, Model]) -> Model:
    """Robots whose rotors are fixed, as this law needs them."""
    return models[request.param]


def _base(x: Array, model: Model, a_WB: Array | None = None, dw_B: Array | None = None) -> BaseMotion:
    s = model.state.unpack(x)
    rest = [None if v is None else ca.DM(v) for v in (a_WB, dw_B)]
    return BaseMotion(*(ca.DM(s[n]) for n in ("p_WB", "q_WB", "v_WB", "w_B")), *rest)


def _dm(value: ca.DM) -> Array:
    return ca.DM(value).full().ravel()


def _turn(q: Array, w_B: Array, h: float) -> Array:
    return _dm(so3.product(ca.DM(q), so3.exponential(ca.DM(h * w_B))))


# error dynamics


def test_errors_obey_14_and_17_under_any_wrench(model: Model) -> None:
    """With thrusts that act at once: e_p'' + K_p1 e_p' + K_p2 e_p = 0 and e_w' = -K_R1 e_w - K_R2 e_R at any error."""
    rng, h = np.random.default_rng(31), 1e-6
    gains = PoseGains(*(rng.uniform(1, 10, size=3) for _ in range(4)))
    for _ in range(10):
        x, x_r, wrench = random_state(model, rng), random_state(model, rng), rng.normal(size=6)
        a_r, dw_r = rng.normal(size=3), rng.normal(size=3)
        base, reference = _base(x, model), _base(x_r, model, a_r, dw_r)
        wanted = pose_accelerations(model, base, reference, gains)
        x[13:] = _dm(inverse_dynamics(model, base, *wanted, ca.DM(wrench[:3]), ca.DM(wrench[3:])))
        a, dw = (_dm(v) for v in model.accelerations(ca.DM(x), ca.DM(wrench)))
        s, r = model.state.unpack(x), model.state.unpack(x_r)

        def com(s: dict[str, Array], a: Array, dw: Array) -> tuple[Array, Array, Array]:
            R, c, w = rotation(s["q_WB"]), model.robot.p_BC, s["w_B"]
            turned = np.cross(dw, c) + np.cross(w, np.cross(w, c))
            return s["p_WB"] + R @ c, s["v_WB"] + R @ np.cross(w, c), a + R @ turned

        here, there = com(s, a, dw), com(r, a_r, dw_r)
        e, de, dde = (there[i] - here[i] for i in range(3))
        np.testing.assert_allclose(dde + gains.K_p1 * de + gains.K_p2 * e, np.zeros(3), atol=1e-9)

        def e_w(
            t: float, s: dict[str, Array] = s, r: dict[str, Array] = r, dw: Array = dw, dw_r: Array = dw_r
        ) -> Array:
            R, R_r = rotation(_turn(s["q_WB"], s["w_B"], t)), rotation(_turn(r["q_WB"], r["w_B"], t))
            return s["w_B"] + t * dw - R.T @ R_r @ (r["w_B"] + t * dw_r)

        R_BBr = rotation(s["q_WB"]).T @ rotation(r["q_WB"])
        S = R_BBr.T - R_BBr
        e_R = 0.5 * np.array([S[2, 1], S[0, 2], S[1, 0]])
        rate = (e_w(h) - e_w(-h)) / (2 * h)
        np.testing.assert_allclose(rate, -gains.K_R1 * e_w(0.0) - gains.K_R2 * e_R, atol=1e-5)


def test_printed_feed_forward_of_17_is_in_the_wrong_frame(hexarotor: Model) -> None:
    """dw_r as printed is in the reference's axes: away from e_R = 0 the errors do not obey (17)."""
    rng = np.random.default_rng(32)
    x, x_r, dw_r = random_state(hexarotor, rng), random_state(hexarotor, rng), rng.normal(size=3)
    base, zero = _base(x, hexarotor), PoseGains(*[np.zeros(3)] * 4)
    _, wanted = pose_accelerations(hexarotor, base, _base(x_r, hexarotor, np.zeros(3), dw_r), zero)
    assert np.linalg.norm(_dm(wanted) - dw_r) > 0.1
    together = _base(x_r, hexarotor), _base(x_r, hexarotor, np.zeros(3), dw_r)
    _, wanted = pose_accelerations(hexarotor, *together, zero)
    np.testing.assert_allclose(_dm(wanted), dw_r, atol=1e-12)


# reference of the base


def _tool_motion(t: float) -> ToolMotion:
    """A tool motion with known derivatives; the angular velocity has a fixed axis in W."""
    axis = np.array([0.6, -0.64, 0.48])
    angle, rate, change = 0.5 * np.sin(2 * t), np.cos(2 * t), -2 * np.sin(2 * t)
    q = Rotation.from_rotvec(angle * axis).as_quat(scalar_first=True)
    return ToolMotion(
        p_WE=ca.DM([np.sin(t), np.cos(t), 0.3 * t * t]),
        q_WE=ca.DM(q),
        v_WE=ca.DM([np.cos(t), -np.sin(t), 0.6 * t]),
        w_WE=ca.DM(rate * axis),
        a_WE=ca.DM([-np.sin(t), -np.cos(t), 0.6]),
        dw_WE=ca.DM(change * axis),
    )


def test_base_reference_29_30_by_finite_differences(model: Model) -> None:
    h, t = 1e-5, 0.7
    before, now, after = (base_reference(model, _tool_motion(s)) for s in (t - h, t, t + h))
    np.testing.assert_allclose(_dm(after.p_WB - before.p_WB) / (2 * h), _dm(now.v_WB), atol=1e-8)
    np.testing.assert_allclose(_dm(after.v_WB - before.v_WB) / (2 * h), _dm(now.a_WB), atol=1e-8)
    turn = so3.local(before.q_WB, after.q_WB)
    np.testing.assert_allclose(_dm(turn) / (2 * h), _dm(now.w_B), atol=1e-8)
    np.testing.assert_allclose(_dm(after.w_B - before.w_B) / (2 * h), _dm(now.dw_B), atol=1e-8)
    x = np.concatenate([*(_dm(v) for v in (now.p_WB, now.q_WB, now.v_WB, now.w_B)), np.zeros(model.rotors)])
    p_WE, q_WE = model.tool_pose(ca.DM(x))
    np.testing.assert_allclose(_dm(p_WE), _dm(_tool_motion(t).p_WE), atol=1e-12)
    np.testing.assert_allclose(abs(_dm(q_WE) @ _dm(_tool_motion(t).q_WE)), 1, atol=1e-12)


def test_printed_equality_of_angular_velocities_in_30_needs_equal_axes(model: Model) -> None:
    now = base_reference(model, _tool_motion(0.7))
    w_E = rotation(_dm(_tool_motion(0.7).q_WE)).T @ _dm(_tool_motion(0.7).w_WE)
    np.testing.assert_allclose(_dm(now.w_B), model.robot.R_BE @ w_E, atol=1e-12)
    assert np.linalg.norm(_dm(now.w_B) - w_E) > 0.1, "both robots' tools have other axes than their bases"


# filter


def test_reference_starts_at_the_desired_motion(model: Model) -> None:
    rng = np.random.default_rng(33)
    run = Runner(admittance_filter(model, RATE))
    q = random_unit(rng)
    r = {"p_WE_d": rng.normal(size=3), "q_WE_d": q, "v_WE_d": rng.normal(size=3), "w_E_d": rng.normal(size=3)}
    out = run({}, r)
    np.testing.assert_allclose(out["p_WE_r"], r["p_WE_d"], atol=1e-12)
    np.testing.assert_allclose(out["q_WE_r"], q, atol=1e-12)
    np.testing.assert_allclose(out["v_WE_r"], r["v_WE_d"], atol=1e-12)
    np.testing.assert_allclose(out["w_WE_r"], rotation(q) @ r["w_E_d"], atol=1e-12)
    np.testing.assert_allclose(out["a_WE_r"], np.zeros(3), atol=1e-12)


def test_filter_follows_a_smooth_desired_motion_without_wrench(model: Model) -> None:
    run = Runner(admittance_filter(model, RATE))
    for k in range(1000):
        d = _tool_motion(k / RATE)
        R_EW = rotation(_dm(d.q_WE)).T
        r = {
            "p_WE_d": _dm(d.p_WE),
            "q_WE_d": _dm(d.q_WE),
            "v_WE_d": _dm(d.v_WE),
            "w_E_d": R_EW @ _dm(d.w_WE),
            "a_WE_d": _dm(d.a_WE),
            "dw_E_d": R_EW @ _dm(d.dw_WE),
        }
        out = run({}, r)
    np.testing.assert_allclose(out["p_WE_r"], r["p_WE_d"], atol=2e-4)
    np.testing.assert_allclose(abs(out["q_WE_r"] @ r["q_WE_d"]), 1, atol=1e-7)
    np.testing.assert_allclose(out["v_WE_r"], r["v_WE_d"], atol=2e-4)


def test_filter_gives_way_to_force_and_torque(model: Model) -> None:
    run = Runner(admittance_filter(model, RATE).with_parameters({"K_EP": 6.0, "K_ER": [10.0, 10.0, 5.0]}))
    y = {"f_tool_W": [1.4, 0.0, 0.0], "tau_tool_W": [0.0, 1.2, 0.0]}
    start = run({})
    for _ in range(10_000):
        out = run(y)
    np.testing.assert_allclose(out["p_WE_r"] - start["p_WE_r"], [(1.4 - 0.2) / 6, 0, 0], atol=1e-4)
    turn = (
        Rotation.from_quat(out["q_WE_r"], scalar_first=True)
        * Rotation.from_quat(start["q_WE_r"], scalar_first=True).inv()
    )
    np.testing.assert_allclose(turn.as_rotvec(), [0, np.arcsin((1.2 - 0.2) / 10), 0], atol=1e-4)


# closed loop


def test_default_input_gives_hover_thrust(model: Model) -> None:
    for build in (pose_control, ryll2019_admittance):
        out = Runner(build(model, RATE))({})
        np.testing.assert_allclose(out["thrust_cmd"], model.robot.hover_thrust, atol=1e-9)


def test_the_law_is_the_filter_followed_by_pose_control(model: Model) -> None:
    rng = np.random.default_rng(34)
    whole = ryll2019_admittance(model, RATE).with_parameters(GAINS)
    parts = Runner(admittance_filter(model, RATE)), pose_control(model, RATE).with_parameters(GAINS)
    law = Runner(whole)
    p_d, q_d = law.block.reference.default[:3], law.block.reference.default[3:7]
    for _ in range(20):
        s = model.state.unpack(random_state(model, rng))
        y = {**s, **{n: rng.normal(size=3) for n in ("f_ext_W", "tau_ext_B", "f_tool_W", "tau_tool_W")}}
        r = {"p_WE_d": p_d + 0.01 * rng.normal(size=3), "q_WE_d": q_d}
        tool = ToolMotion(**{f"{n}_WE": ca.DM(v) for n, v in _filtered(parts[0](y, r)).items()})
        base = base_reference(model, tool)
        names = ("p_WB", "q_WB", "v_WB", "w_B", "a_WB", "dw_B")
        follow = {f"{n}_r": _dm(getattr(base, n)) for n in names}
        y_pose, y_whole = (
            b.measurement.pack({k: v for k, v in y.items() if k in b.measurement}) for b in (parts[1], whole)
        )
        _, thrust = parts[1].step([], y_pose, parts[1].reference.pack(follow), parts[1].parameters.default)
        z, out = whole.step(law.z, y_whole, whole.reference.pack(r), whole.parameters.default)
        law.z = z.full().ravel()
        np.testing.assert_allclose(out.full().ravel()[: model.rotors], thrust.full().ravel(), atol=1e-9)


def _filtered(out: dict[str, Array]) -> dict[str, Array]:
    return {name.removesuffix("_WE_r"): value for name, value in out.items()}


def _loop(model: Model, build: LawBuilder = ryll2019_admittance, **more: Any) -> ClosedLoop:
    law = build(model, RATE).with_parameters(GAINS)
    return ClosedLoop(model, law, wrench_observer(model, RATE).with_parameters(OBSERVER), **more)


def test_hover_holds(model: Model) -> None:
    loop = _loop(model)
    loop.x[0:3] += [0.05, -0.03, 0.04]
    loop.x[10:13] = [0.2, -0.1, 0.3]
    log = loop.run(4.0)
    np.testing.assert_allclose(log["p_WB"][-1], model.hover_state[:3], atol=2e-4)
    np.testing.assert_allclose(np.abs(log["q_WB"][-1]), model.hover_state[3:7], atol=1e-4)


def _trajectory(start: Array, t: float) -> dict[str, Array]:
    """Smooth from rest: a figure in space while the base rolls to 0.15 rad and back."""
    grow = 1 - np.exp(-t)
    p = np.array([0.3 * np.sin(t), 0.2 * (1 - np.cos(t)), 0.1 * np.sin(0.5 * t)])
    v = np.array([0.3 * np.cos(t), 0.2 * np.sin(t), 0.05 * np.cos(0.5 * t)])
    a = np.array([-0.3 * np.sin(t), 0.2 * np.cos(t), -0.025 * np.sin(0.5 * t)])
    rise = np.exp(-t)
    roll, rate, change = 0.15 * np.sin(t), 0.15 * np.cos(t), -0.15 * np.sin(t)
    return {
        "p_WB_r": start + grow * p,
        "v_WB_r": grow * v + rise * p,
        "a_WB_r": grow * a + 2 * rise * v - rise * p,
        "q_WB_r": np.array([np.cos(roll / 2), np.sin(roll / 2), 0, 0]),
        "w_B_r": np.array([rate, 0, 0]),
        "dw_B_r": np.array([change, 0, 0]),
    }


def test_pose_trajectory_is_tracked(model: Model) -> None:
    loop = _loop(model, pose_control)
    wanted = [_trajectory(model.hover_state[:3], k / RATE) for k in range(int(8 * RATE))]
    log = loop.run(8.0, references=np.array([loop.law.reference.pack(r) for r in wanted]))
    settled = slice(int(2 * RATE), None)
    p_r, q_r = (np.array([r[n] for r in wanted]) for n in ("p_WB_r", "q_WB_r"))
    distance = np.linalg.norm(log["p_WB"] - p_r, axis=1)[settled]
    angle = 2 * np.arccos(np.minimum(1.0, np.abs((log["q_WB"] * q_r).sum(axis=1))))[settled]
    assert distance.size > 1000
    assert distance.max() < 0.005
    assert np.degrees(angle.max()) < 0.5


def test_constant_wrench_is_rejected_without_steady_error(model: Model) -> None:
    wrench = [0.8, -0.5, 0.6, 0.05, 0.1, -0.05]
    log = _loop(model, pose_control).run(8.0, wrench)
    np.testing.assert_allclose(log["p_WB"][-1], model.hover_state[:3], atol=1e-5)
    np.testing.assert_allclose(np.abs(log["q_WB"][-1]), [1, 0, 0, 0], atol=1e-5)
    np.testing.assert_allclose(log["f_ext_W"][-1], wrench[:3], atol=1e-4)
    assert np.abs(log["p_WB"] - model.hover_state[:3]).max() > 1e-3, "the wrench must be felt at first"


def test_compensation_26_as_printed_leaves_an_offset(model: Model) -> None:
    """Printed, the wrench stands in a sum of accelerations: force times mass, torque times inertia are compensated."""
    robot, force = model.robot, 0.2

    def printed(told: dict[str, Any]) -> dict[str, Any]:
        f, tau = robot.mass * told["f_ext_W"], ca.mtimes(ca.DM(robot.J_C), told["tau_ext_B"])
        return {**told, "f_ext_W": f, "tau_ext_B": tau}

    offsets = []
    for alter in (None, printed):
        log = _loop(model, pose_control, alter=alter).run(12.0, [force, 0, 0, 0, 0, 0])
        offsets.append(log["p_WB"][-1, 0] - model.hover_state[0])
    assert abs(offsets[0]) < 1e-5
    expected = force * (1 - robot.mass) / (robot.mass * GAINS["K_p2"])
    assert offsets[1] == pytest.approx(expected, rel=0.3)


def test_admittance_settles_at_force_over_stiffness(model: Model) -> None:
    """'Physical properties shaping' of the paper: 1.4 N less the dead zone of 0.2 N, over 6 N/m."""
    log = _loop(model).run(12.0, [1.4, 0, 0, 0, 0, 0])
    start = log["p_WE"][0]
    np.testing.assert_allclose(log["p_WE_r"][-1] - start, [0.2, 0, 0], atol=2e-3)
    np.testing.assert_allclose(log["p_WE"][-1] - start, [0.2, 0, 0], atol=2e-3)
    assert (log["p_WE_r"] - start)[:, 0].min() > -1e-3, "never against the force"


# what the paper says of the robot


def test_rotor_position_5_as_printed_leaves_the_rotor_axis(hexarotor: Model) -> None:
    """Without R_z on its second term, d = d z of (5) is not along the thrust of rotors 2 to 6."""
    for i, rotor in enumerate(hexarotor.robot.rotors):
        turn = Rotation.from_euler("z", 60 * i, degrees=True)
        tilt = Rotation.from_euler("XY", [30 * (-1) ** i, 10], degrees=True)
        np.testing.assert_allclose((turn * tilt).apply([0, 0, 1]), rotor.axis_B, atol=1e-12)
        apart = np.linalg.norm(tilt.apply([0, 0, 1]) - rotor.axis_B)
        assert (apart < 1e-12) == (i == 0)


def test_inertia_as_printed_is_no_hexarotor(hexarotor: Model) -> None:
    """1e-6 kg m2 at 1.8 kg is a radius of gyration of millimetres; the rotors sit at 0.4 m."""
    robot = hexarotor.robot
    radius = np.sqrt(np.diag(robot.J_C) / robot.mass)
    assert (radius > 0.1).all()
    assert (radius < max(np.linalg.norm(r.p_BR) for r in robot.rotors)).all()
    assert np.sqrt(19.4e-6 / 1.8) < 0.004


def test_tool_points_down(hexarotor: Model) -> None:
    """The paper's tool descends onto tables: its tip is below the base, not at z = +0.4 m."""
    np.testing.assert_allclose(hexarotor.robot.p_BE, [0.12, 0, -0.4], atol=1e-12)


def test_robot_without_lateral_force_is_refused(hexarotor: Model) -> None:
    upright = tuple(replace(r, axis_B=np.array([0.0, 0.0, 1.0])) for r in hexarotor.robot.rotors)
    flat = Model(replace(hexarotor.robot, rotors=upright))
    for build in (pose_control, ryll2019_admittance):
        with pytest.raises(MissingCapability, match="six_axis_wrench"):
            build(flat, RATE)
    with pytest.raises(MissingCapability, match="tool"):
        admittance_filter(Model(replace(hexarotor.robot, has_tool=False)), RATE)
