"""The surface ahead of the tool in the loop: served by name, at the camera's rate, logged, true if asked for."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from aerotact.codegen.project import block_project
from aerotact.controller import Controller
from aerotact.dynamics.model import Model
from aerotact.exceptions import LoopError
from aerotact.experiments.reference import Hold, WithFlags
from aerotact.flight import ESTIMATORS, SEEING, controller_project, estimator_names
from aerotact.loop import Loop, Wiring
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import BlockBuilder
from aerotact.robot import load_robot
from aerotact.sight import SURFACE

FOLDER = Path(__file__).parent / "fixtures" / "octorotor"
DISTANCE = 0.29  # m from the octorotor's tip at hover to the world "wall"


@cache
def _model() -> Model:
    return Model(load_robot(FOLDER))


def _still(asks: bool) -> Controller:
    """Gives the hover thrusts whatever happens, and asks for the surface's signals or not."""
    b = BlockBuilder("still_asking" if asks else "still", "test", 250.0, "hover thrusts")
    b.measurement("gyro_B", 3, "rad/s", frame="B")
    if asks:
        for port in SURFACE.values():
            b.measurement(port.name, port.size, port.unit, frame=port.frame, kind=port.kind)
    b.output("thrust_cmd", _model().robot.hover_thrust, "N", default=tuple(_model().robot.hover_thrust))
    return Controller(block_project(b.build(), _model()))


def _loop(
    asks: bool = True,
    truth: bool = False,
    world: str | None = "wall",
    estimators: tuple[str, ...] = ("state_estimator", SEEING),
) -> Loop:
    plant = Plant(_model().robot, world)
    chain = [Controller(controller_project(name, _model(), 500.0)) for name in estimators]
    reference = WithFlags(Hold(*_model().hover_tool), {"calibrate": (0.0, 0.0)})
    return Loop(plant, Sensors(plant, plant.robot, 4), chain, _still(asks), Wiring(reference, truth))


def test_controller_gets_the_cameras_surface_at_the_cameras_rate() -> None:
    log = _loop().run(0.4, {})
    assert log.fault == ""
    distance = log["surface_distance_est"][:, 0]
    np.testing.assert_allclose(distance, DISTANCE, atol=2e-3)
    np.testing.assert_array_equal(distance, np.repeat(distance[::20], 20))  # 50 Hz
    assert len(set(distance)) == 20
    np.testing.assert_array_equal(log["surface_valid_est"], 1.0)
    np.testing.assert_allclose(np.linalg.norm(log["n_W_est"], axis=1), 1.0, atol=1e-12)
    assert (log["n_W_est"] @ [-1, 0, 0] > np.cos(np.radians(1.5))).all()  # the attitude is estimated as well


@pytest.mark.parametrize("asks", [True, False])
def test_log_has_the_surface_asked_for_or_not(asks: bool) -> None:
    log = _loop(asks).run(0.1, {})
    np.testing.assert_allclose(log["surface_distance"], DISTANCE, atol=1e-4)
    np.testing.assert_allclose(log["n_W"], np.tile([-1, 0, 0], (100, 1)), atol=1e-12)
    for name, port in SURFACE.items():
        assert log.ports[name] == port
        shown = log.ports[f"{name}_est"]
        assert (shown.unit, shown.frame, shown.size) == (port.unit, port.frame, port.size)
        assert log[f"{name}_est"].shape == log[name].shape
    assert 0 < np.abs(log["surface_distance_est"] - DISTANCE).max() < 2e-3


def test_truth_is_the_geometry_of_the_world() -> None:
    log = _loop(truth=True).run(0.1, {})
    for name in SURFACE:
        rows = log.stepped(slice(0, 100))
        np.testing.assert_array_equal(log[f"{name}_est"][rows], log[name][rows])


def test_nothing_to_see_is_far_and_flagged() -> None:
    log = _loop(world=None).run(0.05, {})
    for suffix in ("", "_est"):
        np.testing.assert_array_equal(log[f"surface_valid{suffix}"], 0.0)
        np.testing.assert_array_equal(log[f"surface_distance{suffix}"], 4.0)
    np.testing.assert_allclose(log["n_W"], np.tile([-1, 0, 0], (50, 1)), atol=1e-3)


def test_camera_needs_an_attitude_and_a_rate_that_fits(tmp_path: Path) -> None:
    with pytest.raises(LoopError, match=r"nothing serves q_WB of surface_estimator"):
        _loop(estimators=(SEEING,))
    with pytest.raises(LoopError, match=r"nothing serves surface_distance, n_W, surface_valid of still_asking"):
        _loop(estimators=("state_estimator",))
    loop = _loop()
    for name in ("plant.xml", "robot.toml"):
        text = (FOLDER / name).read_text()
        (tmp_path / name).write_text(text.replace("rate = 50.0", "rate = 200.0"))
    plant = Plant(load_robot(tmp_path), "wall")
    with pytest.raises(LoopError, match=r"the depth camera runs at 200 Hz; valid: 500 Hz, the IMU's, divided"):
        Loop(plant, Sensors(plant, plant.robot, 0), loop.estimators, loop.controller, loop.wiring)


def test_surface_is_estimated_for_robots_with_a_camera() -> None:
    assert estimator_names(_model().robot) == (*ESTIMATORS, SEEING)
    blind = load_robot("tilt_hex")
    assert estimator_names(blind) == ESTIMATORS
    assert Sensors(Plant(blind, "table"), blind, 0).depth_camera is None
