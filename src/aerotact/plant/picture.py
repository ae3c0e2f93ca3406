"""Picture: a robot, where its plant stands or at hover, rendered into a PNG file."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.image import imsave

from aerotact.plant.plant import Plant
from aerotact.robot import Robot

_BACKENDS = ("egl", "osmesa", "glfw")
_TIMEOUT = 60.0


@dataclass(frozen=True)
class Camera:
    """Where the picture is taken from.

    Attributes:
        azimuth: direction of view about z of W, degrees; 90 looks along y.
        elevation: degrees; negative looks down.
        distance: from the point looked at, m.
        offset_W: of the point looked at from the base's origin, m.
    """

    azimuth: float = 138.0
    elevation: float = -21.0
    distance: float = 1.5
    offset_W: tuple[float, float, float] = (0.02, 0.0, -0.17)


@dataclass(frozen=True)
class Picture:
    """What came of `render`: true if the file was written.

    Attributes:
        file: where the picture is or would have been.
        reason: why there is none, in one line; empty if there is one.
    """

    file: Path
    reason: str = ""

    def __bool__(self) -> bool:
        return not self.reason


def render(
    robot_or_plant: Robot | Plant,
    file: str | Path,
    width: int = 1280,
    height: int = 960,
    camera: Camera | None = None,
    world: str | Path = "floor",
) -> Picture:
    """Render a robot at hover in a world, or a plant in its own world as it stands.

    The work is done by another process, since a machine without OpenGL may end the process that asks for it, and since
    MuJoCo chooses its backend once, when it is imported: $MUJOCO_GL if that is set, then EGL, OSMesa, GLFW.

    Args:
        robot_or_plant: what to show.
        file: PNG file to write.
        width: pixels.
        height: pixels.
        camera: where from; None is from in front of the robot, to its left and a little above.
        world: for a robot, the world to put it into.

    Returns:
        A `Picture`, false with a reason where no picture can be made. Never raises for the lack of OpenGL or of a
        folder that can be written.
    """
    plant = robot_or_plant if isinstance(robot_or_plant, Plant) else Plant(robot_or_plant, world)
    file, view = Path(file).resolve(), camera or Camera()
    model = np.zeros(mujoco.mj_sizeModel(plant.model), np.uint8)
    mujoco.mj_saveModel(plant.model, None, model)
    shot = {
        "model": model,
        "qpos": plant.data.qpos,
        "lookat": plant.base_pose()[:3],
        "size": np.array([width, height]),
        "camera": np.array([view.azimuth, view.elevation, view.distance]),
        "offset": np.array(view.offset_W),
    }
    reasons = []
    for backend in dict.fromkeys((os.environ.get("MUJOCO_GL") or "egl", *_BACKENDS)):
        reason = _in_subprocess(shot, file, backend)
        if not reason:
            return Picture(file)
        reasons.append(f"{backend}: {reason}")
    return Picture(file, f"no picture {file.name}: {'; '.join(reasons)}")


def _in_subprocess(shot: Mapping[str, Any], file: Path, backend: str) -> str:
    """Empty, or the reason for the failure in one line."""
    path = os.pathsep.join(str(Path(p).resolve()) for p in sys.path)
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder, "shot.npz"), **shot)
        try:
            done = subprocess.run(
                [sys.executable, "-m", __name__, str(Path(folder, "shot.npz")), str(file)],
                env=os.environ | {"MUJOCO_GL": backend, "PYTHONPATH": path},
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
    if done.returncode == 0 and file.is_file():
        return ""
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return (lines[-1] if lines else f"ended with status {done.returncode}")[:200]


def _take(shot: Mapping[str, Any], file: Path) -> None:
    """Render and write; runs in the other process."""
    model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": shot["model"].tobytes()})
    width, height = (int(v) for v in shot["size"])
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.shadowsize, model.vis.quality.offsamples = 4096, 8
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.36, 0.28
    model.vis.rgba.haze[:3] = 0.82, 0.87, 0.93
    data = mujoco.MjData(model)
    data.qpos[:] = shot["qpos"]
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = (float(v) for v in shot["camera"])
    camera.lookat[:] = shot["lookat"] + shot["offset"]
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        imsave(file, renderer.render(), pil_kwargs={"optimize": True})


if __name__ == "__main__":
    with np.load(sys.argv[1]) as archive:
        _take(dict(archive), Path(sys.argv[2]))
