"""Worlds: found by name and path, joined without disturbing the robot, refused when they clash."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.plant import Plant
from aerotact.plant.world import find_world, world_files
from aerotact.robot import Robot, load_robot


def test_worlds_of_the_package() -> None:
    assert set(world_files()) >= {"floor", "wall", "table"}


@pytest.mark.parametrize("world", ["floor", "wall", "table", "pitched_wall", "undulating_wall"])
def test_only_surfaces_collide(world: str, tilt_hex: Robot) -> None:
    model = Plant(tilt_hex, world).model
    of_world = np.flatnonzero(model.body_rootid[model.geom_bodyid] != model.body(tilt_hex.file.robot.base).rootid)
    assert of_world.size > 0
    colliding = [model.geom(g).name for g in of_world if model.geom_contype[g] or model.geom_conaffinity[g]]
    assert all(name.startswith("surface") for name in colliding)
    assert len(colliding) == {"floor": 0, "undulating_wall": 30}.get(world, 1)


def test_faces_are_where_they_are_said_to_be(tilt_hex: Robot) -> None:
    wall = Plant(tilt_hex, "wall").model.geom("surface_wall")
    table = Plant(tilt_hex, "table").model.geom("surface_table")
    assert wall.pos[0] - wall.size[0] == pytest.approx(1.0, abs=1e-15)
    assert table.pos[2] + table.size[2] == pytest.approx(0.8, abs=1e-15)
    assert wall.friction[0] == 0.5
    assert table.friction[0] == 0.4


def test_pitched_wall_leans_back_by_30_degrees(octorotor: Robot) -> None:
    plant = Plant(octorotor, "pitched_wall")
    wall = plant.data.geom("surface_wall")
    n_W = -wall.xmat.reshape(3, 3)[:, 0]
    np.testing.assert_allclose(n_W, [-np.cos(np.pi / 6), 0, np.sin(np.pi / 6)], atol=1e-12)
    np.testing.assert_allclose(wall.xpos + 0.05 * n_W, [1, 0, 1.2], atol=1e-12)


def test_robots_options_stay(robot: Robot) -> None:
    alone, joined = robot.mjmodel, Plant(robot, "wall", timestep=5e-4).model
    assert joined.opt.timestep == 5e-4
    assert joined.opt.integrator == alone.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert joined.opt.cone == alone.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    np.testing.assert_array_equal(joined.opt.gravity, alone.opt.gravity)


MOVING = """<mujoco>
  <worldbody>
    <body name="ball" pos="3 0 1"><freejoint/><geom type="sphere" size="0.1" mass="1"/>
      <body name="arm"><joint name="hinge"/><geom type="sphere" size="0.05" mass="0.1"/></body></body>
  </worldbody>
  <actuator><motor name="swing" joint="hinge"/></actuator>
</mujoco>"""


def test_a_world_may_move(robot: Robot, tmp_path: Path) -> None:
    """Joints and actuators of the world do not disturb the robot's trim."""
    file = tmp_path / "moving.xml"
    file.write_text(MOVING)
    plant = Plant(robot, file)
    assert plant.model.nu == robot.mjmodel.nu + 1
    for _ in range(100):
        plant.step()
    truth = plant.truth()
    np.testing.assert_allclose(truth["v_WB"], 0.0, atol=1e-12)
    np.testing.assert_allclose(truth["thrust"], robot.hover_thrust, rtol=1e-12)
    assert plant.data.body("ball").xpos[2] < 1.0


def test_robot_without_tool_in_a_world_with_other_contacts(octorotor: Robot, tmp_path: Path) -> None:
    """A ball that lies on a plate is no contact of the robot's, whether it has a tool or not."""
    text = (octorotor.folder / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace('tool = "lance_end"', ""))
    (tmp_path / "plant.xml").write_text((octorotor.folder / "plant.xml").read_text())
    file = tmp_path / "ball.xml"
    file.write_text(
        '<mujoco><worldbody><geom name="surface" type="box" size="1 1 0.1" pos="3 0 0"/>'
        '<body name="ball" pos="3 0 0.2"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    for robot in (octorotor, load_robot(tmp_path)):
        plant = Plant(robot, file)
        for _ in range(20):
            plant.step()
        truth = plant.truth()
        assert plant.data.ncon == 1
        assert ("f_contact_W" in truth) == robot.has_tool
        np.testing.assert_array_equal(truth.get("f_contact_W", np.zeros(3)), 0.0)


def test_unknown_world_is_refused(tilt_hex: Robot) -> None:
    with pytest.raises(UnknownName, match=r"unknown world 'wal'; valid: block, .*floor, .*undulating_wall, wall"):
        Plant(tilt_hex, "wal")


@pytest.mark.parametrize(
    "text",
    [
        "<mujoco><worldbody>",
        '<mujoco><worldbody><geom type="cube"/></worldbody></mujoco>',
        '<mujoco><worldbody><body name="base"><geom size="1"/></body></worldbody></mujoco>',
    ],
    ids=["broken", "invalid", "taken name"],
)
def test_bad_world_is_refused(text: str, tilt_hex: Robot, tmp_path: Path) -> None:
    file = tmp_path / "bad.xml"
    file.write_text(text)
    with pytest.raises(InputError, match=r"bad\.xml"):
        Plant(tilt_hex, file)


def test_find_world_takes_a_path() -> None:
    path = world_files()["wall"]
    assert find_world(path) == find_world(str(path)) == path
