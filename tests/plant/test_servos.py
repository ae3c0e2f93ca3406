"""Tilt servos: lag and rate limit beside the same ordinary differential equation, the reaction on the body, truth."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aerotact.exceptions import InputError
from aerotact.plant.plant import Plant
from aerotact.robot import Robot, load_robot


def _run(plant: Plant, tilt: np.ndarray, steps: int) -> dict[str, np.ndarray]:
    plant.command(plant.robot.hover_thrust, tilt)
    rows = []
    for _ in range(steps):
        plant.step()
        rows.append(plant.truth())
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("angle", [0.05, 0.2, 2.0])
def test_shaft_follows_with_lag_and_limited_rate(tilting: Robot, angle: float) -> None:
    """Small steps are slower than the limit from the start, large ones first run at it."""
    servo = tilting.tilts[0]
    plant = Plant(tilting)
    seen = _run(plant, np.resize([angle, -angle], 6), 500)

    def slope(t: float, a: np.ndarray) -> np.ndarray:
        return np.clip((angle - a) / servo.time_constant, *servo.rate)

    times = np.arange(1, 501) * plant.timestep
    exact = solve_ivp(slope, (0, 0.5), [0.0], t_eval=times, rtol=1e-10, atol=1e-12, max_step=1e-3).y[0]
    # The spring between shaft and rotor is late by 2 d / k, which is 2 ms.
    late = 2.2e-3 * np.abs(np.gradient(exact, times)).max()
    assert np.abs(seen["tilt"][:, 0] - exact).max() < late
    assert seen["tilt"][-1, 0] == pytest.approx(exact[-1], abs=0.05 * (angle - exact[-1]))
    np.testing.assert_allclose(seen["tilt"][:, 1], -seen["tilt"][:, 0], atol=1e-6)
    fastest = np.abs(seen["tilt_rate"]).max()
    assert fastest < 1.04 * min(servo.rate[1], angle / servo.time_constant)
    assert np.abs(seen["tilt_rate_cmd"]).max() == pytest.approx(angle / servo.time_constant)


def test_command_is_cut_to_the_range_and_held(tilting: Robot) -> None:
    plant = Plant(tilting)
    _run(plant, np.full(6, 100.0), 3000)
    np.testing.assert_allclose(plant.truth()["tilt"], tilting.tilts[0].angle[1], atol=1e-4)
    plant.command(tilting.hover_thrust)  # the angles stay as they were commanded
    plant.step()
    np.testing.assert_allclose(plant.truth()["tilt"], tilting.tilts[0].angle[1], atol=1e-4)
    plant.reset()
    truth = plant.truth()
    for name in ("tilt", "tilt_rate", "tilt_rate_cmd"):
        np.testing.assert_array_equal(truth[name], np.zeros(6))
    for _ in range(100):
        plant.step()
    np.testing.assert_allclose(plant.truth()["tilt"], 0.0, atol=1e-9)


def test_turning_groups_push_the_body_back(tilting: Robot) -> None:
    """Without thrust and gravity nothing turns the whole: the body turns against the groups."""
    plant = Plant(tilting, timestep=1e-4)
    plant.model.opt.gravity[:] = 0.0
    plant.model.actuator_gainprm[plant._actuators] = 0.0
    _run(plant, 0.5 * np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0]), 5000)
    truth = plant.truth()
    np.testing.assert_allclose(truth["w_B"], 0.0, atol=1e-5)
    turned = 2 * truth["q_WB"][1:]
    axis_B = tilting.tilts[0].axis_B
    expected = -np.linalg.solve(tilting.J_C, 2 * 2e-4 * 0.5 * axis_B)
    np.testing.assert_allclose(turned, expected, rtol=0.02, atol=1e-6)
    assert np.linalg.norm(turned) < 2.5e-3


def test_tilted_thrust_pushes_sideways(tilting: Robot) -> None:
    """All groups across the same way: three pairs whose forces cancel and whose torques about z add."""
    plant = Plant(tilting)
    _run(plant, np.full(6, 0.3), 400)
    truth = plant.truth()
    torque = -6 * 0.3 * tilting.hover_thrust[0] * np.sin(0.3)
    plant.data.qvel[:] = 0.0
    mujoco.mj_forward(plant.model, plant.data)
    assert plant.data.qacc[5] * tilting.J_C[2, 2] == pytest.approx(torque, rel=5e-3)
    np.testing.assert_allclose(truth["tilt"], 0.3, atol=1e-3)


def test_fixed_rotors_have_no_servos(octorotor: Robot) -> None:
    plant = Plant(octorotor)
    assert plant.servos.actuators.size == 0
    assert not {"tilt", "tilt_rate", "tilt_rate_cmd"} & set(plant.truth())
    with pytest.raises(InputError, match=r"tilt is .*valid: 0 finite numbers"):
        plant.command(octorotor.hover_thrust, [0.0])


@pytest.mark.parametrize("tilt", [[0.0], np.full(6, np.nan)])
def test_bad_command_changes_nothing(tilting: Robot, tilt: object) -> None:
    plant = Plant(tilting)
    with pytest.raises(InputError, match=r"tilt is .*valid: 6 finite numbers"):
        plant.command(tilting.hover_thrust + 1.0, tilt)
    np.testing.assert_array_equal(plant.data.ctrl[:6], tilting.hover_thrust)


def test_hover_may_be_tilted(tilting: Robot, tmp_path: Path) -> None:
    """Neighbouring groups tilted against each other by 0.2 rad: the keyframe, the model and the plant agree on it."""
    for name in ("plant.xml", "robot.toml"):
        text = (tilting.folder / name).read_text()
        thrust = repr(float(tilting.hover_thrust[0]))
        more = repr(float(tilting.hover_thrust[0] / np.cos(0.2)))
        angles = "0.2 -0.2 0.2 -0.2 0.2 -0.2"
        text = text.replace(thrust, more).replace('0 0 0 0 0 0"', f'{angles}"')
        (tmp_path / name).write_text(text)
    robot = load_robot(tmp_path)
    np.testing.assert_allclose(robot.hover_tilt, np.resize([0.2, -0.2], 6))
    plant = Plant(robot)
    np.testing.assert_allclose(plant.truth()["tilt"], robot.hover_tilt)
    for _ in range(200):
        plant.step()
    # Drag torques about the tilted axes add up, since they alternate like the angles: 6 c T sin(0.2) cancels in pairs.
    np.testing.assert_allclose(plant.truth()["p_WB"], [0, 0, 1.5], atol=1e-6)
    np.testing.assert_allclose(plant.truth()["tilt"], robot.hover_tilt, atol=1e-6)
