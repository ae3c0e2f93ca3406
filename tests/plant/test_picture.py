"""Pictures: written where OpenGL is found, and a reason where not; never an exception."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from aerotact.plant import picture
from aerotact.plant.picture import Camera, render
from aerotact.plant.plant import Plant
from aerotact.robot import Robot


def test_picture_of_a_robot(tilt_hex: Robot, tmp_path: Path) -> None:
    result = render(tilt_hex, tmp_path / "robot.png", width=160, height=120)
    if not result:
        pytest.skip(result.reason)
    pixels = imread(tmp_path / "robot.png")[..., :3]
    assert pixels.shape == (120, 160, 3)
    assert pixels.std() > 0.05
    orange = (pixels[..., 0] > 0.5) & (pixels[..., 2] < 0.7 * pixels[..., 0])
    assert orange.mean() > 0.005, "no orange propellers in the picture"


def test_picture_of_a_plant_follows_its_state(tilt_hex: Robot, tmp_path: Path) -> None:
    plant = Plant(tilt_hex, "table")
    files = [tmp_path / "level.png", tmp_path / "turned.png"]
    for file, q in zip(files, ([1, 0, 0, 0], [0.9238795325112867, 0, 0, 0.3826834323650898]), strict=True):
        plant.reset(q_WB=q)
        result = render(plant, file, width=80, height=60, camera=Camera(azimuth=90.0))
        if not result:
            pytest.skip(result.reason)
    assert np.abs(imread(files[0]) - imread(files[1])).max() > 0.1


def test_without_opengl_there_is_a_reason(
    tilt_hex: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(picture, "_BACKENDS", ("none_such",))
    monkeypatch.setenv("MUJOCO_GL", "none_such")
    result = render(tilt_hex, tmp_path / "robot.png")
    assert not result
    assert "none_such" in result.reason
    assert "\n" not in result.reason
    assert not (tmp_path / "robot.png").exists()
    assert capfd.readouterr() == ("", "")


def test_folder_that_is_missing_is_a_reason(tilt_hex: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_BACKENDS", ("egl",))
    monkeypatch.setenv("MUJOCO_GL", "egl")
    result = render(tilt_hex, tmp_path / "none" / "robot.png", width=40, height=30)
    assert not result
    assert result.reason
