"""SurfaceAhead: the true surface in front of a plant's tool."""

import numpy as np

from aerotact.plant.plant import Plant
from aerotact.plant.rays import Rays
from aerotact.ports import Array

_BEHIND = 0.2  # m; the ray starts behind the tip, which a soft surface may have let in


class SurfaceAhead:
    """What the tool would touch if it went on along its z axis, by the geometry of the plant's world."""

    def __init__(self, plant: Plant, reach: float) -> None:
        """Look along the tool.

        Args:
            plant: of a robot with a tool.
            reach: what is further away than this from the tip is not seen, m.
        """
        self._plant, self._rays, self._reach = plant, Rays(plant), reach

    def sample(self) -> dict[str, Array]:
        """The surface now.

        Returns:
            surface_distance: m from the tip along the tool's axis, shape (1,), negative by the depth to which the tip
                has pressed in; the reach if there is nothing.
            n_W: unit normal of the surface there, towards the robot; against the tool's axis if there is nothing.
            surface_valid: 1 if there is a surface, shape (1,).
        """
        data, site = self._plant.data, self._plant.tip.site
        axis_W = data.site_xmat[site].reshape(3, 3)[:, 2].copy()
        distance, n_W = self._rays.first(data.site_xpos[site] - _BEHIND * axis_W, axis_W)
        distance -= _BEHIND
        if not -_BEHIND <= distance <= self._reach:
            return {"surface_distance": np.array([self._reach]), "n_W": -axis_W, "surface_valid": np.zeros(1)}
        return {"surface_distance": np.array([distance]), "n_W": n_W, "surface_valid": np.ones(1)}
