"""The depth camera: what it sees, what it must not see, its noise, its seed and bad entries of robot.toml."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from test_sensors import folder_with

from aerotact.exceptions import RobotError
from aerotact.plant.camera import DepthCamera
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.robot import Robot, load_robot

WALL = 1.0  # m, the plane x of the world "wall"


def _camera(plant: Plant, seed: int = 0) -> DepthCamera:
    camera = Sensors(plant, plant.robot, seed).depth_camera
    assert camera is not None
    return camera


def _in_world(plant: Plant, points_C: Array) -> Array:
    site = plant.data.site("eye")
    return points_C @ site.xmat.reshape(3, 3).T + site.xpos


def _noiseless(octorotor: Robot, folder: Path) -> Robot:
    return load_robot(
        folder_with(octorotor, folder, ("robot.toml", 'value = 0.005, unit = "1"', 'value = 0.0, unit = "1"'))
    )


def test_points_lie_on_the_wall_and_not_on_the_robot(octorotor: Robot, tmp_path: Path) -> None:
    """The lance and its tip are in the middle of the picture; a camera that saw them would give nearer points."""
    plant = Plant(_noiseless(octorotor, tmp_path), "wall")
    for p_WB, q_WB in (([0.2, 0, 1.2], [1, 0, 0, 0]), ([0.1, 0.2, 1.3], [0.98, 0.1, -0.1, 0.1386])):
        plant.reset(p_WB, q_WB)
        points = _in_world(plant, _camera(plant).points())
        assert len(points) == 56 * 56
        np.testing.assert_allclose(points[:, 0], WALL, atol=1e-12)


def test_a_visible_lance_would_be_seen(octorotor: Robot, tmp_path: Path) -> None:
    """The same geom, fixed to the world, hides the wall: so it is the robot that is invisible, not what is thin."""
    file = tmp_path / "rod.xml"
    file.write_text(
        '<mujoco><worldbody><geom name="rod" type="capsule" size="0.008" fromto="0.1 0 1.22 0.69 0 1.22"/>'
        '<geom name="surface" type="box" size="0.05 1 1" pos="1.05 0 1.2"/></worldbody></mujoco>'
    )
    robot = _noiseless(octorotor, tmp_path)
    plant = Plant(robot, file)
    plant.reset([0, 0, 1.2])
    depth = _in_world(plant, _camera(plant).points())[:, 0]
    assert 20 < (depth < 0.7).sum() < 1000
    assert (np.abs(depth - WALL) < 1e-12).sum() > 2000


def test_picture_has_x_to_the_right_and_y_down(octorotor: Robot) -> None:
    camera = _camera(Plant(octorotor, "wall"))
    grid = camera.directions_C.reshape(56, 56, 3)
    np.testing.assert_allclose(np.linalg.norm(grid, axis=2), 1.0, atol=1e-15)
    assert (np.diff(grid[:, :, 0] / grid[:, :, 2], axis=1) > 0).all()
    assert (np.diff(grid[:, :, 1] / grid[:, :, 2], axis=0) > 0).all()
    edge = np.tan(0.14) * 55 / 56  # middle of the last pixel
    assert grid[0, -1, 0] / grid[0, -1, 2] == pytest.approx(edge, abs=1e-15)


def test_calibration_is_that_of_the_model(octorotor: Robot) -> None:
    plant = Plant(octorotor, "wall")
    plant.reset([0.1, -0.2, 1.5], [0.5, 0.5, -0.5, 0.5])
    camera, eye, tool = _camera(plant), plant.data.site("eye"), plant.data.site("lance_end")
    R_WE = tool.xmat.reshape(3, 3)
    np.testing.assert_allclose(R_WE @ camera.p_EC + tool.xpos, eye.xpos, atol=1e-12)
    np.testing.assert_allclose(R_WE @ camera.R_EC, eye.xmat.reshape(3, 3), atol=1e-12)


def test_noise_is_proportional_to_the_range(octorotor: Robot) -> None:
    plant = Plant(octorotor, "wall")
    camera = _camera(plant)
    for x in (0.2, -0.8):
        plant.reset([x, 0, 1.2])
        true = plant.data.site("eye")
        away = (WALL - true.xpos[0]) / (camera.directions_C @ true.xmat.reshape(3, 3).T)[:, 0]
        share = np.array([np.linalg.norm(camera.points(), axis=1) / away - 1.0 for _ in range(10)])
        assert share.std() == pytest.approx(0.005, rel=0.03)
        assert abs(share.mean()) < 5 * 0.005 / np.sqrt(share.size)


def test_out_of_range_gives_no_points(octorotor: Robot) -> None:
    plant = Plant(octorotor, "wall")
    camera = _camera(plant)
    plant.reset([-6.0, 0, 50.0])
    assert camera.points().shape == (0, 3)
    plant.reset([0.7, 0, 1.2])
    assert camera.points().shape == (0, 3)
    assert _camera(Plant(octorotor)).points().shape == (0, 3)


def test_equal_seeds_give_equal_frames_and_other_sensors_do_not_notice(octorotor: Robot, tmp_path: Path) -> None:
    plant = Plant(octorotor, "wall")
    first, second, third = (_camera(plant, seed).points() for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert (first != third).all()
    text = (octorotor.folder / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(text[: text.index("[sensors.depth_camera]")])
    (tmp_path / "plant.xml").write_text((octorotor.folder / "plant.xml").read_text())
    blind, seeing = Sensors(plant, load_robot(tmp_path), 3), Sensors(plant, octorotor, 3)
    assert blind.depth_camera is None
    for _ in range(3):
        seeing.depth_camera.points()  # type: ignore[union-attr]
        np.testing.assert_array_equal(blind.imu()["gyro_B"], seeing.imu()["gyro_B"])


SPOILT = {
    "no site": (("robot.toml", 'site = "eye"', 'site = "ear"'), "no site 'ear'; name one of: .*eye"),
    "moving site": (
        (
            "plant.xml",
            '<site name="eye" pos="-0.07 0 0.12" xyaxes="0 -1 0 -0.127166 0 -0.991881"/>',
            '<body name="neck"><joint/><geom size="0.01" mass="0.01"/><site name="eye"/></body>',
        ),
        "moves against the base",
    ),
    "no tool": (("robot.toml", 'tool = "lance_end"', ""), "no tool"),
    "noise in metres": (
        ("robot.toml", 'value = 0.005, unit = "1"', 'value = 0.005, unit = "m"'),
        "one number >= 0 in 1",
    ),
    "range turned": (("robot.toml", "[0.5, 6.0]", "[6.0, 0.5]"), "shortest < longest"),
    "view too wide": (("robot.toml", "[0.28, 0.28]", "[3.2, 0.28]"), r"two angles in \(0, pi\)"),
    "one pixel": (("robot.toml", "[56, 56]", "[56, 1]"), "2 x 2 pixels"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_bad_entries_are_refused(case: str, octorotor: Robot, tmp_path: Path) -> None:
    change, named = SPOILT[case]
    folder = folder_with(octorotor, tmp_path, change)
    if case == "moving site":
        text = (folder / "plant.xml").read_text()
        (folder / "plant.xml").write_text(text.replace('qpos="0 0 1.2 1 0 0 0"', 'qpos="0 0 1.2 1 0 0 0 0"'))
    robot = load_robot(folder)
    with pytest.raises(RobotError, match=named):
        Sensors(Plant(robot), robot, seed=0)


def test_wall_that_moves_is_seen_where_it_is(octorotor: Robot, tmp_path: Path) -> None:
    file = tmp_path / "sliding.xml"
    file.write_text(
        '<mujoco><worldbody><body name="wall" pos="1.05 0 1.2" gravcomp="1">'
        '<joint name="rail" type="slide" axis="1 0 0"/>'
        '<geom name="surface" type="box" size="0.05 1 1"/></body></worldbody></mujoco>'
    )
    plant = Plant(_noiseless(octorotor, tmp_path), file)
    plant.reset([0, 0, 1.2])
    plant.data.joint("rail").qpos[0] = 0.3
    mujoco.mj_forward(plant.model, plant.data)
    np.testing.assert_allclose(_in_world(plant, _camera(plant).points())[:, 0], 1.3, atol=1e-12)
