"""DepthCamera: a time-of-flight camera on the robot, which sees the world as points."""

import mujoco
import numpy as np

from aerotact.exceptions import RobotError
from aerotact.plant.plant import Plant
from aerotact.plant.rays import Rays
from aerotact.ports import Array
from aerotact.robot import Robot
from aerotact.robot_file import DepthCameraEntry, Quantity


class DepthCamera:
    """One ray a pixel, from the camera's site; what is out of range or empty gives no point.

    Pixels are equal steps of the image plane at unit depth (a pinhole). The noise of a range is white, independent from
    pixel to pixel, and proportional to the range. The robot's own bodies are not seen.

    Attributes:
        rate: Hz.
        range: shortest and longest range that is measured, m.
        p_EC, R_EC: where the camera is in the tool's frame E by plant.xml, m, shapes (3,) and (3, 3): its calibration.
            A disturbance that moves the tool or the camera is not in it.
        directions_C: unit vectors of the pixels in C, shape (n, 3).
    """

    def __init__(self, plant: Plant, robot: Robot, entry: DepthCameraEntry, rng: np.random.Generator) -> None:
        """Place it.

        Args:
            plant: what is seen.
            robot: who carries the camera.
            entry: sensors.depth_camera of its robot.toml.
            rng: of the noise.

        Raises:
            RobotError: no such site, a site that moves against the base, a robot without a tool, a value out of range.
        """
        self._file, self._plant, self._rng = robot.folder / "robot.toml", plant, rng
        self.rate = entry.rate
        low, high = self._numbers("range", entry.range, "m", 2)
        if not 0.0 <= low < high:
            raise self._wrong("range", entry.range, "give [shortest, longest] in m with 0 <= shortest < longest")
        self.range = (float(low), float(high))
        self._noise = float(self._numbers("range_noise", entry.range_noise, "1", 0))
        angles = self._numbers("field_of_view", entry.field_of_view, "rad", 2)
        if not ((angles > 0.0) & (angles < np.pi)).all() or min(entry.resolution) < 2:
            raise self._wrong(
                "field_of_view", entry.field_of_view, "give two angles in (0, pi) rad, and at least 2 x 2 pixels"
            )
        right, down = (
            np.linspace(-1.0, 1.0, 2 * pixels + 1)[1::2] * np.tan(angle / 2)
            for pixels, angle in zip(entry.resolution, angles, strict=True)
        )
        grid = np.stack([*np.meshgrid(right, down), np.ones(entry.resolution[::-1])], axis=-1).reshape(-1, 3)
        self.directions_C = grid / np.linalg.norm(grid, axis=1, keepdims=True)
        self.p_EC, self.R_EC = self._calibration(robot, entry.site)
        self._site = int(plant.model.site(entry.site).id)
        self._rays = Rays(plant)

    def _wrong(self, part: str, quantity: Quantity, remedy: str) -> RobotError:
        fault = f"is {quantity.value} {quantity.unit}"
        return RobotError(self._file, f"sensors.depth_camera.{part}", fault, remedy)

    def _numbers(self, part: str, quantity: Quantity, unit: str, size: int) -> Array:
        value = quantity.array
        shape = (size,) if size else ()
        if quantity.unit != unit or value.shape != shape or not (np.isfinite(value) & (value >= 0.0)).all():
            what = f"{size} numbers" if size else "one number"
            raise self._wrong(part, quantity, f"give {what} >= 0 in {unit}")
        return value

    def _calibration(self, robot: Robot, site: str) -> tuple[Array, Array]:
        """Pose of the camera in the tool's frame by the robot's own plant.xml."""
        model = robot.mjmodel
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
        part = "sensors.depth_camera.site"
        if index < 0:
            names = ", ".join(model.site(i).name for i in range(model.nsite))
            raise RobotError(self._file, part, f"plant.xml has no site '{site}'", f"name one of: {names}")
        weld = model.body_weldid[model.site_bodyid[index]]
        if weld != model.body_weldid[robot.base_id]:
            raise RobotError(self._file, part, f"'{site}' moves against the base", "weld its body to the base")
        if not robot.has_tool:
            raise RobotError(self._file, part, "there is no tool to look along", "give robot.tool")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        R_WB, p_WB = data.xmat[robot.base_id].reshape(3, 3), data.xpos[robot.base_id]
        p_BC, R_BC = R_WB.T @ (data.site_xpos[index] - p_WB), R_WB.T @ data.site_xmat[index].reshape(3, 3)
        return robot.R_BE.T @ (p_BC - robot.p_BE), robot.R_BE.T @ R_BC

    def points(self) -> Array:
        """One frame.

        Returns:
            Points in the camera's frame C, m, shape (k, 3); k is at most the number of pixels and may be 0.
        """
        data = self._plant.data
        R_WC = data.site_xmat[self._site].reshape(3, 3)
        ranges = self._rays.cast(data.site_xpos[self._site], self.directions_C @ R_WC.T, self.range[1])
        noise = self._rng.normal(size=len(ranges))  # for every pixel, so that a frame's draws do not depend on the view
        seen = (ranges >= self.range[0]) & (ranges <= self.range[1])
        measured = ranges[seen] * (1.0 + self._noise * noise[seen])
        return measured[:, None] * self.directions_C[seen]
