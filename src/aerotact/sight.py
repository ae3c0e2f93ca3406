"""Sight: the surface ahead of the tool as it is, and as the depth camera shows it."""

from aerotact.estimation.point_patch import point_patch
from aerotact.estimation.surface_estimator import REACH
from aerotact.plant.camera import DepthCamera
from aerotact.plant.plant import Plant
from aerotact.plant.surface import SurfaceAhead
from aerotact.ports import Array, Port

SURFACE = {
    "surface_distance": Port(
        "surface_distance", 1, "m", doc="from the tool's tip to the surface along the tool's axis"
    ),
    "n_W": Port("n_W", 3, "1", "W", doc="unit normal of the surface, towards the robot"),
    "surface_valid": Port("surface_valid", 1, "1", doc="1 if there is a surface", kind="flag"),
}


class Sight:
    """The surface ahead of the tool: as it is, and as the depth camera shows it."""

    def __init__(self, plant: Plant, camera: DepthCamera) -> None:
        self.rate = camera.rate
        self._camera = camera
        self._ahead = SurfaceAhead(plant, REACH)

    def truth(self) -> dict[str, Array]:
        """The signals of SURFACE by the world's geometry."""
        return self._ahead.sample()

    def patch(self) -> dict[str, Array]:
        """The points about the tool's axis in a new frame of the camera."""
        camera = self._camera
        return point_patch(camera.points(), camera.p_EC, camera.R_EC)
