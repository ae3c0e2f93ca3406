"""Rays: lines of sight through a plant's world, to which the robot itself is invisible."""

import copy

import mujoco
import numpy as np

from aerotact.plant.plant import Plant
from aerotact.ports import Array

_SEEN = np.array([1, 0, 0, 0, 0, 0], np.uint8)


class Rays:
    """Casts rays at what a plant's world holds, wherever its bodies stand at the moment."""

    def __init__(self, plant: Plant) -> None:
        """Hide the robot: in a copy of the model its geoms are in a group that no ray meets.

        Args:
            plant: whose world is seen; later changes of its state are followed, those of its geoms' shapes are not.
        """
        self._data = plant.data
        self._model = copy.copy(plant.model)
        own = plant.model.body_rootid == plant.model.body_rootid[plant.base_id]
        self._model.geom_group[:] = own[plant.model.geom_bodyid]
        self._geom = np.zeros(1, np.int32)
        self._normal = np.zeros(3)

    def cast(self, p_W: Array, directions_W: Array, cutoff: float) -> Array:
        """Distances to what rays from one point meet first.

        Args:
            p_W: the point, m, shape (3,).
            directions_W: unit vectors, shape (n, 3).
            cutoff: geoms further away than this are not looked at, m.

        Returns:
            m, shape (n,); -1 where a ray meets nothing.
        """
        n = len(directions_W)
        geoms, distances = np.zeros(n, np.int32), np.zeros(n)
        rays = np.ascontiguousarray(directions_W, dtype=float).reshape(-1)
        mujoco.mj_multiRay(self._model, self._data, p_W, rays, _SEEN, True, -1, geoms, distances, None, n, cutoff)
        return distances

    def first(self, p_W: Array, direction_W: Array) -> tuple[float, Array]:
        """What one ray meets first.

        Args:
            p_W: where the ray starts, m, shape (3,).
            direction_W: unit vector, shape (3,).

        Returns:
            Distance, m, -1 if the ray meets nothing; unit normal of the surface there, on the ray's side, shape (3,).
        """
        distance = mujoco.mj_ray(self._model, self._data, p_W, direction_W, _SEEN, True, -1, self._geom, self._normal)
        normal = self._normal.copy()
        return float(distance), normal if normal @ direction_W <= 0.0 else -normal
