"""Mismatch: the disturbed plant beside a robot whose plant.xml says the same."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.exceptions import InputError
from aerotact.plant.mismatch import CentreOfMassError, MassError, TiltError, ToolYawError
from aerotact.plant.plant import Plant
from aerotact.robot import Robot

TURNED = np.array([0.8, 0.3, -0.4, np.sqrt(1 - 0.64 - 0.09 - 0.16)])


def _acceleration(plant: Plant) -> np.ndarray:
    """Of the base, turned, spinning and pushed at the tool."""
    plant.reset(q_WB=TURNED)
    plant.data.qvel[3:6] = 0.5, -0.8, 0.3
    mujoco.mj_forward(plant.model, plant.data)
    plant.push_tool(np.array([1.0, -2.0, 0.5]), np.zeros(3))
    mujoco.mj_forward(plant.model, plant.data)
    return plant.data.qacc[:6].copy()


def _edited(robot: Robot, **base: object) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(robot.folder / "plant.xml"))
    body = spec.body(robot.file.robot.base)
    for name, value in base.items():
        setattr(body, name, value)
    return spec.compile()


def test_centre_of_mass_error_is_that_of_an_edited_file(tilt_hex: Robot, tilting: Robot) -> None:
    offset = np.array([0.005, -0.003, 0.002])
    for robot in (tilt_hex, tilting):
        plant = Plant(robot, disturbances=[CentreOfMassError(tuple(offset))])
        alone = robot.mjmodel
        moved = alone.body_ipos[robot.base_id] + offset * robot.mass / alone.body_mass[robot.base_id]
        expected = Plant(robot)
        model = _edited(robot, ipos=moved)
        for name in ("body_ipos", "body_sameframe", "body_simple", "dof_simplenum"):
            getattr(expected.model, name)[:] = getattr(model, name)
        np.testing.assert_allclose(_acceleration(plant), _acceleration(expected), atol=1e-10)
        R_WB = plant.data.xmat[plant.base_id].reshape(3, 3)
        p_BC = R_WB.T @ (plant.data.subtree_com[plant.base_id] - plant.data.xpos[plant.base_id])
        np.testing.assert_allclose(p_BC, robot.p_BC + offset, atol=1e-12)
        assert np.abs(_acceleration(plant) - _acceleration(Plant(robot))).max() > 0.05


def test_mass_error_divides_what_pushes(robot: Robot) -> None:
    nominal, heavier = (_acceleration(Plant(robot, disturbances=d)) for d in ([], [MassError(0.05)]))
    free = Plant(robot)
    free.model.opt.gravity[:] = 0.0
    # Without gravity and spin all accelerations are forces over masses.
    for plant in (free, lighter := Plant(robot, disturbances=[MassError(0.25)])):
        plant.model.opt.gravity[:] = 0.0
        plant.push_tool(np.array([1.0, -2.0, 0.5]), np.zeros(3))
        mujoco.mj_forward(plant.model, plant.data)
    np.testing.assert_allclose(free.data.qacc[:6], 1.25 * lighter.data.qacc[:6], atol=1e-8)
    assert np.abs(nominal - heavier).max() > 0.05
    assert robot.mjmodel.body_subtreemass[robot.base_id] == pytest.approx(robot.mass)


def test_tool_yaw_error_turns_tool_and_sensor(tilt_hex: Robot, tilting: Robot) -> None:
    angle = np.deg2rad(10)
    c, s = np.cos(angle), np.sin(angle)
    Rz = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for robot in (tilt_hex, tilting):
        plant = Plant(robot, disturbances=[ToolYawError(angle)])
        R_WE = plant.data.site_xmat[plant.tip.site].reshape(3, 3)
        np.testing.assert_allclose(plant.truth()["p_WE"] - plant.truth()["p_WB"], Rz @ robot.p_BE, atol=1e-12)
        np.testing.assert_allclose(R_WE, Rz @ robot.R_BE, atol=1e-12)


def test_tilt_error_turns_the_rotors_and_not_the_encoders(tilting: Robot) -> None:
    zero = np.deg2rad([1.0, -1.0, 0.5, 0.0, -0.5, 2.0])
    plant = Plant(tilting, disturbances=[TiltError(tuple(zero))])
    for _ in range(100):
        plant.step()
    np.testing.assert_allclose(plant.truth()["tilt"], zero, atol=1e-5)
    np.testing.assert_allclose(plant.servos.shaft(), 0.0, atol=1e-12)


def test_backlash_is_a_play(tilting: Robot) -> None:
    """The rotor stands behind the shaft by half of the play on the way up and before it on the way down."""
    play = np.deg2rad(1.0)
    plant = Plant(tilting, disturbances=[TiltError(backlash=play)])
    ends = []
    for target in (0.3, -0.3, 0.3, 0.295):
        plant.command(tilting.hover_thrust, np.resize([target, -target], 6))
        for _ in range(1000):
            plant.step()
        ends.append(plant.truth()["tilt"][0] - target)
    np.testing.assert_allclose(ends, [-play / 2, play / 2, -play / 2, -play / 2 + 0.005], atol=2e-5)


@pytest.mark.parametrize(
    ("error", "named"),
    [
        (lambda: MassError(-1.0), "MassError: share is -1.0"),
        (lambda: CentreOfMassError((np.nan, 0, 0)), "CentreOfMassError: offset_B"),
        (lambda: ToolYawError(np.inf), "ToolYawError: angle"),
        (lambda: TiltError(backlash=-0.1), "TiltError: .*backlash -0.1"),
        (lambda: TiltError((0.0, np.nan)), "TiltError: zero"),
    ],
)
def test_bad_numbers_are_refused(error: object, named: str) -> None:
    with pytest.raises(InputError, match=rf"{named}.*valid"):
        error()  # type: ignore[operator]


def test_what_the_robot_cannot_bear_is_refused(tilt_hex: Robot, octorotor: Robot, tilting: Robot) -> None:
    with pytest.raises(InputError, match=r"TiltError: .*'tilt_hex' has 0 tilting rotors; valid"):
        Plant(tilt_hex, disturbances=[TiltError(0.01)])
    with pytest.raises(InputError, match=r"TiltError: zero has shape \(2,\), .* 6 tilting"):
        Plant(tilting, disturbances=[TiltError((0.01, 0.02))])
    with pytest.raises(InputError, match=r"ToolYawError: robot 'octorotor' has no such tool"):
        Plant(octorotor, disturbances=[ToolYawError(0.1)])


def test_disturbed_plant_stands_beside_a_sound_one(tilting: Robot, tmp_path: Path) -> None:
    """A disturbance changes its plant's model and no other."""
    Plant(tilting, disturbances=[MassError(0.1), CentreOfMassError((0.01, 0, 0)), ToolYawError(0.1), TiltError(0.1)])
    plant = Plant(tilting)
    for _ in range(50):
        plant.step()
    np.testing.assert_allclose(plant.truth()["p_WB"], [0, 0, 1.5], atol=1e-9)
