"""Gusts on a body of the robot, and joints that begin off hover."""

from pathlib import Path

import numpy as np
import pytest

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.displaced import Displaced
from aerotact.plant.gust import Gust
from aerotact.plant.plant import Plant
from aerotact.ports import Array
from aerotact.robot import Robot, load_robot

LONG = Path(__file__).parents[2] / "models" / "dual_arm_long_reach"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(LONG)


def _forces(robot: Robot, gust: Gust, seconds: float, seed: int = 0) -> Array:
    """What acts on the body, step by step."""
    plant = Plant(robot, disturbances=[gust], seed=seed)
    body, found = plant.model.body(gust.body).id, []
    for _ in range(round(seconds * 1000)):
        plant.step()
        found.append(plant.data.xfrc_applied[body, :3].copy())
        plant.reset() if plant.truth()["p_WB"][2] < 0.5 else None
    return np.array(found)


def test_gust_has_its_mean_spread_and_memory(robot: Robot) -> None:
    plant = Plant(robot)
    gust = Gust("arm_left_forearm", 0.2, 0.05, (0.0, 0.0, -0.1))
    gust.begin(plant)
    body, forces = plant.model.body(gust.body).id, []
    plant.data.time = 1.0
    for _ in range(40_000):
        plant.data.xfrc_applied[:] = 0.0
        gust.apply(plant)
        forces.append(plant.data.xfrc_applied[body].copy())
    force, torque = np.array(forces)[:, :3], np.array(forces)[:, 3:]
    np.testing.assert_allclose(force.mean(axis=0), [0, 0, -0.1], atol=0.03)
    np.testing.assert_allclose(force.std(axis=0), 0.2, rtol=0.1)
    kept = np.corrcoef(force[:-50, 0], force[50:, 0])[0, 1]
    assert kept == pytest.approx(np.exp(-1.0), abs=0.1)
    assert np.abs(torque).max() < 1e-12  # at the centre of mass


def test_gust_depends_on_the_seed_alone(robot: Robot) -> None:
    runs = [_forces(robot, Gust("base", 0.5, 0.8), 0.1, seed) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2]).max() > 0.01


def test_joint_begins_displaced_and_every_reset_brings_it_back(robot: Robot) -> None:
    plant = Plant(robot, "floor", disturbances=[Displaced("swing", 0.2)])
    start = plant.truth()["joint"][0]
    assert start == pytest.approx(Plant(robot).truth()["joint"][0] + 0.2, abs=1e-15)
    for _ in range(200):
        plant.step()
    assert plant.truth()["joint"][0] < start - 0.01
    plant.reset()
    assert plant.truth()["joint"][0] == start


def test_what_cannot_be_is_refused(robot: Robot) -> None:
    with pytest.raises(UnknownName, match=r"body 'sail'.*arm_left_forearm"):
        Plant(robot, disturbances=[Gust("sail", 1.0, 1.0)])
    with pytest.raises(UnknownName, match=r"joint 'knee' in robot 'dual_arm_long_reach'; valid: .*swing"):
        Plant(robot, disturbances=[Displaced("knee", 0.1)])
    with pytest.raises(InputError, match=r"deviation -1 N"):
        Gust("base", -1, 1.0)
    with pytest.raises(InputError, match=r"time constant 0"):
        Gust("base", 1.0, 0)
    with pytest.raises(InputError, match=r"angle is nan"):
        Displaced("swing", float("nan"))
