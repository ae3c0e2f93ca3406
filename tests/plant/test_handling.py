"""What arms handle: clamp, placement, grip, plug, hook, friction on every arm's tip; each by a balance of forces."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.clamp import Clamp
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.plant.grip import Grip
from aerotact.plant.hook import Hook
from aerotact.plant.placement import Placement
from aerotact.plant.plant import Plant
from aerotact.plant.plug import Plug
from aerotact.robot import Robot, load_robot

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(MODELS / "dual_arm_standard")


def _run(robot: Robot, world: str | None, seconds: float, *disturbances: Disturbance, seed: int = 0) -> Plant:
    plant = Plant(robot, world, disturbances=[Clamp(), *disturbances], seed=seed)
    for _ in range(round(seconds * 1000)):
        plant.step()
    return plant


def test_clamp_holds_the_base_against_rotors_and_a_pull(robot: Robot) -> None:
    plant = _run(robot, None, 2.0, ToolForce((5.0, 3.0, -4.0), 0.0, 2.0))
    start = Plant(robot).base_pose()
    np.testing.assert_allclose(plant.base_pose(), start, atol=1e-8)
    assert np.abs(plant.truth()["joint"] - Plant(robot).truth()["joint"]).max() > 0.1


def test_placement_moves_what_stands_and_what_is_free(robot: Robot) -> None:
    plant = _run(robot, "handled", 0.0, Placement("bar", (1.0, 2.0, 3.0)), Placement("hole", (4.0, 5.0, 6.0)))
    poses = dict(zip(plant.objects, plant.truth()["objects_W"].reshape(-1, 7), strict=True))
    np.testing.assert_allclose(poses["bar"][:3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(plant.data.body("hole").xpos, [4.0, 5.0, 6.0])


def test_placement_with_a_spread_is_drawn_by_the_seed(robot: Robot) -> None:
    found = [_run(robot, None, 0.0, Placement("base", (0, 0, 2), 0.1), seed=s).base_pose()[:3] for s in (1, 1, 2)]
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 1e-3
    assert all(np.abs(p - [0, 0, 2]).max() <= 0.1 for p in found)


def test_placement_names_what_there_is(robot: Robot) -> None:
    with pytest.raises(UnknownName, match="bar"):
        _run(robot, "handled", 0.0, Placement("box", (0, 0, 0)))


def test_grips_carry_the_bar_and_feel_its_weight(robot: Robot) -> None:
    hands = [Grip(arm, "bar", (0.0, side * 0.15, 0.0)) for arm, side in enumerate((1.0, -1.0))]
    plant = _run(robot, "handled", 5.0, *hands, Placement("bar", (0.25, 0.0, 1.55)))
    forces = plant.truth()["f_tools_W"].reshape(2, 3)
    weight = 9.81 * plant.model.body("bar").mass[0]
    np.testing.assert_allclose(forces[:, 2], -weight / 2, atol=0.01)
    np.testing.assert_allclose(forces.sum(axis=0)[:2], 0.0, atol=0.01)


def test_plug_holds_up_to_its_pull_and_no_further(robot: Robot) -> None:
    plant = Plant(robot, disturbances=[Clamp(), Plug(0.1, (1.0, 1.0))])
    pulls = []
    for k in range(4000):
        servo = robot.mjmodel.key("hover").ctrl[6:].copy()
        outwards = min(0.6, 2e-4 * max(0, k - 200))
        servo[[1, 5]] += outwards  # both shoulder rolls
        plant.command(robot.hover_thrust, servo=servo)
        plant.step()
        pulls.append(plant.truth()["f_tools_W"])
    forces = np.linalg.norm(np.array(pulls)[:, :3], axis=1)
    assert 0.95 < forces.max() <= 1.0
    assert forces[-1] == 0.0
    np.testing.assert_allclose(np.array(pulls)[:, :3], -np.array(pulls)[:, 3:], atol=1e-9)


def test_hooks_carry_the_tool_at_its_bar_and_let_it_go_downwards(robot: Robot) -> None:
    bar, half, floor = (0.0, 0.0, 0.25), 0.225, 0.016
    hooks = [Hook(arm, "tool", bar, half, floor=floor) for arm in range(2)]
    plant = _run(robot, "pipe_and_bench", 4.0, *hooks, Placement("tool", (0.25, 0.0, 1.55 + floor - 0.25)))
    seen = []
    for _ in range(4000):
        plant.step()
        seen.append(plant.truth()["f_tools_W"].reshape(2, 3))
    forces, weight = np.mean(seen, axis=0), 9.81 * 0.3  # it still swings about its bar
    np.testing.assert_allclose(forces[:, 2], -weight / 2, atol=0.02)
    x, y, z = plant.truth()["objects_W"][:3]
    tools = plant.truth()["p_tools_W"].reshape(2, 3)
    assert z + 0.25 - tools[:, 2].mean() == pytest.approx(floor, abs=0.004)
    assert abs(x - tools[:, 0].mean()) < 0.02
    assert abs(y) < 0.01
    # Forearms hanging down let it slide off.
    servo = robot.mjmodel.key("hover").ctrl[6:].copy()
    servo[[3, 7]] = 0.9
    for _ in range(1500):
        plant.command(robot.hover_thrust, servo=servo)
        plant.step()
    np.testing.assert_array_equal(plant.truth()["f_tools_W"], 0.0)


def test_friction_acts_on_the_right_tip_too(robot: Robot) -> None:
    plant = Plant(robot, "block", disturbances=[Clamp(), Placement("block", (0.25, -0.15, 1.55 + 0.0275))])
    servo = robot.mjmodel.key("hover").ctrl[6:].copy()
    start = servo[7]
    for k in range(5000):
        servo[7] = start - 0.25 * min(1.0, k / 3000)  # the right elbow presses upwards, slowly
        plant.command(robot.hover_thrust, servo=servo)
        plant.step()
    # The deflected springs balance the contact, by virtual work in MuJoCo's own Jacobian; the mean of a second, since
    # the tip still rings.
    site = plant.model.site("arm_right_tip").id
    dofs = [plant.model.joint(j.name).dofadr[0] for j in robot.arms[1].joints]
    forces, lacking = [], []
    for _ in range(1000):
        J = np.zeros((3, plant.model.nv))
        mujoco.mj_jacSite(plant.model, plant.data, J, None, site)
        plant.step()
        left, right = plant.truth()["f_tools_W"].reshape(2, 3)
        spring = plant.data.qfrc_actuator[dofs] + plant.data.qfrc_applied[dofs]
        forces.append(right)
        lacking.append(spring + J[:, dofs].T @ right - plant.data.qfrc_bias[dofs])
        np.testing.assert_array_equal(left, 0.0)
    pressing, across = -np.mean(forces, axis=0)[2], np.linalg.norm(np.mean(forces, axis=0)[:2])
    assert pressing > 0.3
    assert 0.02 < across <= 0.5 * pressing
    np.testing.assert_allclose(np.mean(lacking, axis=0), 0.0, atol=0.01)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Plug(0.0, (2.0, 1.0)),
        lambda: Grip(0, "bar", (0.0, np.nan, 0.0)),
        lambda: Grip(0, "bar", (0.0, 0.0, 0.0), stiffness=-1.0),
        lambda: Hook(0, "tool", (0.0, 0.0, 0.25), -1.0),
        lambda: Placement("base", (0.0, 0.0, 0.0), -0.1),
    ],
)
def test_bad_numbers_are_refused(make: object) -> None:
    with pytest.raises(InputError, match="valid"):
        make()  # type: ignore[operator]


def test_grips_and_hooks_name_arms_and_bodies(robot: Robot) -> None:
    with pytest.raises(InputError, match="valid: 0 to 1"):
        _run(robot, "handled", 0.0, Grip(2, "bar", (0.0, 0.0, 0.0)))
    with pytest.raises(UnknownName, match="bar"):
        _run(robot, "handled", 0.0, Hook(0, "tool", (0.0, 0.0, 0.25), 0.2))
