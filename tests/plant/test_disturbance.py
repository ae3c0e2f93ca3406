"""Disturbances: the wrench of a tool force by Newton and Euler, its course in time, bad values."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from aerotact.exceptions import InputError
from aerotact.plant.disturbance import ToolForce, Wind, WrenchNoise
from aerotact.plant.plant import Plant
from aerotact.robot import Robot

ATTITUDES = {
    "level": np.array([1.0, 0.0, 0.0, 0.0]),
    "turned": np.array([0.7, 0.1, -0.5, 0.5]) / np.linalg.norm([0.7, 0.1, -0.5, 0.5]),
}


@pytest.fixture(params=["tilt_hex", "octorotor"])
def rigid(request: pytest.FixtureRequest, tilt_hex: Robot, octorotor: Robot) -> Robot:
    """A robot without hinges, which under a blow give way for an instant."""
    return {"tilt_hex": tilt_hex, "octorotor": octorotor}[request.param]


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("w_B", [(0.0, 0.0, 0.0), (1.0, -0.7, 2.0)])
def test_tool_force_gives_the_wrench_of_newton_and_euler(
    rigid: Robot, attitude: str, w_B: tuple[float, float, float]
) -> None:
    robot = rigid
    force_W, offset_E = np.array([1.2, -0.7, 0.4]), np.array([0.03, -0.05, 0.02])
    plant = Plant(robot, disturbances=[ToolForce(tuple(force_W), 0.0, 1.0, tuple(offset_E))])
    plant.reset(q_WB=ATTITUDES[attitude])
    plant.data.qvel[3:6] = w_B
    mujoco.mj_forward(plant.model, plant.data)
    plant.step()

    w = np.array(w_B)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, ATTITUDES[attitude])
    R_WB = R.reshape(3, 3)
    force_B = R_WB.T @ (force_W - robot.mass * robot.gravity * np.array([0.0, 0.0, 1.0]))
    torque_C = np.cross(robot.p_BE + robot.R_BE @ offset_E - robot.p_BC, R_WB.T @ force_W)
    for rotor, thrust in zip(robot.rotors, robot.hover_thrust, strict=True):
        force_B += thrust * rotor.axis_B
        torque_C += thrust * (np.cross(rotor.p_BR - robot.p_BC, rotor.axis_B) + rotor.drag * rotor.axis_B)
    alpha_B = np.linalg.solve(robot.J_C, torque_C - np.cross(w, robot.J_C @ w))
    a_C = force_B / robot.mass
    a_B = a_C - np.cross(alpha_B, robot.p_BC) - np.cross(w, np.cross(w, robot.p_BC))
    np.testing.assert_allclose(plant.data.qacc[3:6], alpha_B, atol=1e-10)
    np.testing.assert_allclose(plant.data.qacc[:3], R_WB @ a_B, atol=1e-10)
    np.testing.assert_allclose(plant.truth()["f_tool_W"], force_W, atol=1e-15)
    np.testing.assert_array_equal(plant.truth()["f_contact_W"], 0.0)


def test_force_begins_ramps_and_ends(tilt_hex: Robot) -> None:
    plant = Plant(tilt_hex, disturbances=[ToolForce((0.0, 0.0, 2.0), start=0.01, stop=0.05, ramp=0.01)])
    seen = []
    for _ in range(60):
        plant.step()
        seen.append(plant.truth()["f_tool_W"][2])
    expected = [2.0 * max(0.0, min(1.0, (n - 10) / 10, (50 - n) / 10)) for n in range(60)]
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_force_without_ramp_acts_for_its_steps_only(tilt_hex: Robot) -> None:
    force = ToolForce((1.0, 0.0, 0.0), start=0.3, stop=0.6)
    plant = Plant(tilt_hex, disturbances=[force])
    seen = []
    for _ in range(1000):
        plant.step()
        seen.append(plant.truth()["f_tool_W"][0])
    assert sum(seen) == 300.0
    assert seen[299] == 0.0
    assert seen[300] == seen[599] == 1.0
    assert seen[600] == 0.0


def test_forces_add_and_do_not_linger(tilt_hex: Robot) -> None:
    plant = Plant(tilt_hex)
    plant.disturb(ToolForce((1.0, 0.0, 0.0), 0.0, 0.002))
    plant.disturb(ToolForce((0.0, 2.0, 0.0), 0.0, 0.002))
    plant.step()
    np.testing.assert_allclose(plant.truth()["f_tool_W"], [1.0, 2.0, 0.0])
    for _ in range(5):
        plant.step()
    np.testing.assert_array_equal(plant.truth()["f_tool_W"], 0.0)
    np.testing.assert_array_equal(plant.data.xfrc_applied, 0.0)


def test_a_disturbance_may_change_the_model(tilt_hex: Robot) -> None:
    class Heavier:
        def begin(self, plant: Plant) -> None:
            plant.model.body_mass[plant.base_id] *= 1.05

        def apply(self, plant: Plant) -> None:
            pass

    plant = Plant(tilt_hex, disturbances=[Heavier()])
    plant.step()
    assert plant.data.qacc[2] == pytest.approx(-9.81 * (1 - 1 / 1.05), rel=1e-12)
    assert tilt_hex.mjmodel.body_mass[tilt_hex.base_id] == 1.8


@pytest.mark.parametrize(
    "bad",
    [
        {"force_W": (np.nan, 0, 0)},
        {"force_W": (1.0, 0.0)},
        {"offset_E": (np.inf, 0, 0)},
        {"start": -1.0},
        {"stop": 0.5},
        {"stop": np.nan},
        {"ramp": -0.1},
        {"ramp": 0.6},
    ],
)
def test_bad_tool_force_is_refused(bad: dict[str, object]) -> None:
    good = {"force_W": (1.0, 0.0, 0.0), "start": 1.0, "stop": 2.0}
    with pytest.raises(InputError, match=r"ToolForce: .*valid"):
        ToolForce(**(good | bad))  # type: ignore[arg-type]


def test_wind_pushes_the_centre_of_mass(robot: Robot) -> None:
    plant = Plant(robot, disturbances=[Wind((1.0, -2.0, 0.5), start=0.0, stop=0.2)])
    for _ in range(200):
        plant.step()
    expected = np.array([1.0, -2.0, 0.5]) * 0.2 / robot.mass
    mujoco.mj_subtreeVel(plant.model, plant.data)
    np.testing.assert_allclose(plant.data.subtree_linvel[plant.base_id], expected, atol=1e-9)
    np.testing.assert_allclose(plant.truth()["w_B"], 0.0, atol=1e-9)
    np.testing.assert_array_equal(plant.truth()["f_tool_W"], 0.0)


def test_wrench_noise_has_its_deviation_and_bandwidth(tilt_hex: Robot) -> None:
    """On a plant that is held, so that nothing but the noise is seen: 2000 s in steps of 10 ms."""
    noise = WrenchNoise(force=1.4, torque=0.2, bandwidth=2.0)
    plant = Plant(tilt_hex, timestep=0.01, disturbances=[noise], seed=3)
    rows = []
    for k in range(200_000):
        plant.data.time = k * 0.01
        plant.data.xfrc_applied[:] = 0.0
        noise.apply(plant)
        rows.append(plant.data.xfrc_applied[plant.base_id].copy())
    wrench = np.array(rows)
    np.testing.assert_allclose(wrench.std(axis=0), [1.4] * 3 + [0.2] * 3, rtol=0.05)
    correlation = (wrench[1:] * wrench[:-1]).mean(axis=0) / wrench.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-2 * np.pi * 2.0 * 0.01), atol=0.01)
    assert np.abs(np.corrcoef(wrench.T) - np.eye(6)).max() < 0.06


def test_noise_is_of_the_plants_seed_and_begins_anew_at_a_reset(tilt_hex: Robot) -> None:
    def fly(plant: Plant) -> np.ndarray:
        plant.reset()
        for _ in range(50):
            plant.step()
        return plant.base_pose()

    first, other = (Plant(tilt_hex, disturbances=[WrenchNoise(1.0, 0.1)], seed=s) for s in (1, 2))
    end = fly(first)
    np.testing.assert_array_equal(fly(first), end)
    assert not np.array_equal(fly(other), end)


@pytest.mark.parametrize("bad", [{"force": -1.0}, {"torque": np.nan}, {"bandwidth": 0.0}, {"bandwidth": np.inf}])
def test_bad_noise_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"WrenchNoise: .*valid"):
        WrenchNoise(**({"force": 1.0, "torque": 0.1} | bad))


def test_tool_force_needs_a_tool(tilt_hex: Robot) -> None:
    plant = Plant(tilt_hex)
    plant.robot = replace(tilt_hex, has_tool=False)
    with pytest.raises(InputError, match="has no tool"):
        plant.disturb(ToolForce((1.0, 0.0, 0.0), 0.0, 1.0))
