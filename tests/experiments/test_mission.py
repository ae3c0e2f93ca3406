"""Mission: phases follow by time and by what is seen, references are continuous, and a mission that hangs says so."""

from pathlib import Path

import numpy as np
import pytest

from aerotact.dynamics.multibody import Multibody
from aerotact.experiments.suarez2020.mission import ArmTask, Mission, Phase
from aerotact.experiments.suarez2020.sensor_installation import PUSHES
from aerotact.experiments.suarez2020.sensor_installation import installation as sensor
from aerotact.experiments.suarez2020.tool_installation import installation as tool
from aerotact.ports import Array
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module")
def standard() -> Multibody:
    return Multibody(load_robot(MODELS / "dual_arm_standard"))


def _heard(z: float) -> dict[str, Array]:
    return {"objects_W": np.array([0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0])}


def _phases(most: float = 30.0) -> tuple[Phase, ...]:
    arms = {"left": ArmTask(), "right": ArmTask()}
    return (
        Phase(1, "fly", 2.0, arms, (1.0, 0.0, 2.0), 1.5),
        Phase(2, "wait for the object", 1.0, arms, until=lambda scene: bool(scene.p_W[2] > 0.5), most=most),
        Phase(3, "end", 1.0, arms),
    )


def test_phases_go_on_by_time_and_by_what_is_seen(standard: Multibody) -> None:
    mission = Mission(standard, _phases())
    seen = []
    for time in np.arange(0.0, 9.0, 0.1):
        mission.decide(time, _heard(1.0 if time > 6.0 else 0.0))
        seen.append(mission.phase.number)
    starts = {number: 0.1 * seen.index(number) for number in (1, 2, 3)}
    assert starts[2] == pytest.approx(2.0, abs=0.11)
    assert starts[3] == pytest.approx(6.1, abs=0.11)
    assert mission.ended
    assert not mission.failed


def test_a_phase_that_never_ends_fails_the_mission_and_lets_it_go_on(standard: Multibody) -> None:
    mission = Mission(standard, _phases(most=3.0))
    for time in np.arange(0.0, 9.0, 0.1):
        mission.decide(time, _heard(0.0))
    assert mission.failed == 2
    assert mission.ended
    assert mission.sample(np.array([9.0]))["mission_failed"][0, 0] == 1.0


def test_flight_is_a_motion_from_rest_to_rest_with_its_own_derivatives(standard: Multibody) -> None:
    mission = Mission(standard, _phases())
    times = np.arange(0.0, 2.0, 1e-3)
    said = mission.sample(times)
    np.testing.assert_allclose(said["p_WB_r"][[0, -1]], [standard.hover_state[:3], [1.0, 0.0, 2.0]], atol=1e-12)
    for low, high in (("p_WB_r", "v_WB_r"), ("v_WB_r", "a_WB_r")):
        slope = np.gradient(said[low], times, axis=0)[2:-2]
        np.testing.assert_allclose(slope, said[high][2:-2], atol=2e-2)


def test_joystick_is_full_far_away_and_fades_at_the_goal(standard: Multibody) -> None:
    tip = np.array(standard.hover_tool[0])
    for far, expected in ((0.5, 1.0), (0.02, 0.3), (0.0, 0.0)):
        goal = tip + np.array([far, 0.0, 0.0])
        task = ArmTask(steer=lambda scene, goal=goal: goal)
        mission = Mission(standard, (Phase(1, "steer", 1.0, {"left": task, "right": ArmTask()}),))
        mission.decide(0.0, {})
        said = mission.sample(np.zeros(1))
        assert said["operated_left"][0, 0] == 1.0
        np.testing.assert_allclose(said["joystick_left"][0], [expected, 0.0, 0.0], atol=1e-9)


def test_the_papers_phases_are_all_there(standard: Multibody) -> None:
    long_reach = Multibody(load_robot(MODELS / "dual_arm_long_reach"))
    assert sorted({p.number for p in tool(standard).phases}) == list(range(1, 13))
    for push in PUSHES.values():
        assert sorted({p.number for p in sensor(long_reach, push).phases}) == list(range(1, 10))
