"""Survey: the plane before a robot's tool as its depth camera sees it from hover, for planners without a map."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.point_patch import point_patch
from aerotact.estimation.surface_estimator import surface_estimator
from aerotact.exceptions import InputError
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.robot import load_robot

FRAMES = 50  # of the camera: one second at 50 Hz


@dataclass(frozen=True)
class Survey:
    """A plane.

    Attributes:
        p_W: where the tool's axis meets it, m, shape (3,).
        n_W: its unit normal, towards the robot, shape (3,).
    """

    p_W: Array
    n_W: Array


@cache
def survey(robot_name: str, world: str, seed: int = 0) -> Survey:
    """Look from hover: the mean of the planes (30)-(39) of bodie2021 that FRAMES frames give.

    Args:
        robot_name: name or folder.
        world: what stands before the robot.
        seed: of the camera's noise.

    Raises:
        InputError: the robot has no depth camera, or no plane is seen.
    """
    robot = load_robot(robot_name)
    plant, model = Plant(robot, world), Model(robot)
    camera = Sensors(plant, robot, seed).depth_camera
    if camera is None:
        raise InputError(f"robot '{robot.name}' has no depth camera; valid: a robot that has one")
    block = surface_estimator(model, camera.rate)
    p_WE, q_WE = model.hover_tool
    axis_W = Rotation.from_quat(q_WE, scalar_first=True).as_matrix()[:, 2]
    points, normals = [], []
    for _ in range(FRAMES):
        patch = point_patch(camera.points(), camera.p_EC, camera.R_EC)
        measured = block.measurement.pack({**patch, "q_WB": plant.truth()["q_WB"]})
        _, seen = block.step(block.state.default, measured, block.reference.default, block.parameters.default)
        plane = block.output.unpack(seen.full())
        if not plane["surface_valid"]:
            raise InputError(f"'{robot.name}' sees no plane from hover in world '{world}'; valid: one within reach")
        points.append(p_WE + plane["surface_distance"] * axis_W)
        normals.append(plane["n_W"])
    n_W = np.mean(normals, axis=0)
    return Survey(np.mean(points, axis=0), n_W / np.linalg.norm(n_W))
