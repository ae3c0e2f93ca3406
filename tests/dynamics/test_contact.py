"""The contact predictor: its force, handed to MuJoCo, stops the tip as the equations say; far away there is none."""

import casadi as ca
import mujoco
import numpy as np
import pytest
from stepping import random_state, rotation

from aerotact.dynamics.contact import SETTLING, SMOOTH_GAP, Surface, contact_motion, gap, tool_wrench
from aerotact.dynamics.model import Model

STIFFNESS, DAMPING, FRICTION = 2000.0, 150.0, 0.4


def _unit(rng: np.random.Generator) -> np.ndarray:
    n = rng.normal(size=3)
    return n / np.linalg.norm(n)


def _surface(n: np.ndarray, offset: float, rigid: float) -> Surface:
    across = np.cross(n, [0.3, -0.8, 0.5])
    return Surface(ca.DM(n), offset, ca.DM(FRICTION * across / np.linalg.norm(across)), STIFFNESS, DAMPING, rigid)


def _force(model: Model, x: np.ndarray, p: np.ndarray, surface: Surface) -> tuple[float, np.ndarray]:
    symbols = ca.SX.sym("x", x.size)
    moved = contact_motion(model, symbols, ca.DM(p), surface)
    with_contact = ca.DM(p) + tool_wrench(model, symbols[3:7], moved.f_tool_W)
    outputs = [moved.force, moved.f_tool_W, moved.a_WB, moved.dw_B, *model.accelerations(symbols, with_contact)]
    F, f_W, a_WB, dw_B, a_model, dw_model = ca.Function("force", [symbols], outputs)(x)
    np.testing.assert_allclose(a_WB.full(), a_model.full(), atol=1e-9)
    np.testing.assert_allclose(dw_B.full(), dw_model.full(), atol=1e-9)
    return float(F), f_W.full().ravel()


def _at(model: Model, x: np.ndarray, n: np.ndarray, distance: float) -> float:
    """Offset of the plane that is `distance` in front of the tip."""
    p_WE = model.tool_pose(ca.DM(x))[0].full().ravel()
    return float(n @ p_WE) - distance


@pytest.mark.parametrize("name", ["tilt_hex", "octorotor"])
def test_the_rigid_force_stops_the_tip_in_mujoco(models: dict[str, Model], name: str) -> None:
    model = models[name]
    rng, robot = np.random.default_rng(11), model.robot
    data = mujoco.MjData(robot.mjmodel)
    indices = [r.index for r in robot.rotors]
    for _ in range(50):
        x, n, p = random_state(model, rng), _unit(rng), rng.normal(size=6)
        _, f_W = _force(model, x, p, _surface(n, 0.0, 1.0))
        s = model.state.unpack(x)
        R = rotation(s["q_WB"])
        data.qpos[:7], data.qvel[:3], data.qvel[3:6] = x[:7], s["v_WB"], s["w_B"]
        data.act[robot.mjmodel.actuator_actadr[indices]] = s["thrust"]
        mujoco.mj_forward(robot.mjmodel, data)
        lever = s["p_WB"] + R @ robot.p_BE - data.xipos[robot.base_id]
        torque = R @ p[3:] + np.cross(lever, f_W)  # p acts at the COM, which is that of the base's body here
        data.xfrc_applied[robot.base_id] = np.concatenate([p[:3] + f_W, torque])
        mujoco.mj_forward(robot.mjmodel, data)
        w, r = s["w_B"], robot.p_BE
        tip = data.qacc[:3] + R @ (np.cross(data.qacc[3:6], r) + np.cross(w, np.cross(w, r)))
        speed = s["v_WB"] + R @ np.cross(w, r)
        assert n @ tip == pytest.approx(-SETTLING * n @ speed, abs=1e-9)


@pytest.mark.parametrize("rigid", [0.0, 1.0])
def test_friction_is_the_share_of_the_normal_force_that_is_told(model: Model, rigid: float) -> None:
    rng = np.random.default_rng(12)
    for _ in range(20):
        x, n = random_state(model, rng), _unit(rng)
        surface = _surface(n, _at(model, x, n, -0.004), rigid)
        F, f_W = _force(model, x, rng.normal(size=6), surface)
        assert n @ f_W == pytest.approx(F)
        np.testing.assert_allclose(f_W - F * n, F * surface.friction_W.full().ravel(), atol=1e-9 * max(abs(F), 1.0))


def test_the_compliant_force_is_a_spring_behind_the_plane_and_nothing_before_it(model: Model) -> None:
    x, n = model.hover_state, np.array([0.0, 0.0, 1.0])
    force = [_force(model, x, np.zeros(6), _surface(n, _at(model, x, n, d), 0.0))[0] for d in (0.05, -0.005)]
    assert force[0] == pytest.approx(0.0, abs=1e-9)
    assert force[1] == pytest.approx(STIFFNESS * 0.005, rel=STIFFNESS * SMOOTH_GAP * np.exp(-5) / 10)
    surface = _surface(n, _at(model, x, n, 0.03), 0.0)
    assert float(gap(model, ca.DM(x), surface)) == pytest.approx(0.03)


def test_a_force_on_the_tool_as_a_wrench_about_the_centre_of_mass(model: Model) -> None:
    rng = np.random.default_rng(13)
    x, f_W = random_state(model, rng), rng.normal(size=3)
    p = tool_wrench(model, ca.DM(x[3:7]), ca.DM(f_W)).full().ravel()
    R = rotation(model.state.unpack(x)["q_WB"])
    np.testing.assert_allclose(p[:3], f_W)
    np.testing.assert_allclose(p[3:], np.cross(model.robot.p_BE - model.robot.p_BC, R.T @ f_W), atol=1e-14)
