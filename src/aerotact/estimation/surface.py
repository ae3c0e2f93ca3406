"""SurfaceEstimate: distance and normal of the surface ahead of the tool from a camera's points, bodie2021 (30)-(39)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.ports import Array


@dataclass(frozen=True)
class SurfaceEstimate:
    """A plane in front of the tool.

    Attributes:
        distance: from the tool's tip to the plane along the tool's z axis, d_t = gamma of (38), m.
        n_E: unit normal of the plane in E, towards the robot, so that its z is not positive, shape (3,).
        points: number of points that the plane was fitted to.
        residual: rms distance of these points to the plane, m.
        valid: the plane can be trusted; if not, distance and normal say that nothing is near, see `fit_surface`.
    """

    distance: float
    n_E: Array
    points: int
    residual: float
    valid: bool


@dataclass(frozen=True)
class SurfaceLimits:
    """Which points are used, and which planes are believed.

    Attributes:
        radius: of the cylinder about the tool's axis that holds the used points, d_pi of (30), m.
        points: fewest points.
        residual: largest rms distance of the points to the plane, m.
        spread: least rms extent of the points along every direction in the plane, m; a full disc has radius / 2.
        slope: least cosine of the angle between the tool's axis and the normal.
        reach: largest distance, m.
    """

    radius: float = 0.1
    points: int = 30
    residual: float = 0.025
    spread: float = 0.025
    slope: float = 0.3
    reach: float = 4.0


def fit_surface(points_E: Array, limits: SurfaceLimits | None = None) -> SurfaceEstimate:
    """Plane through the points about the tool's axis, bodie2021 (30) and (32)-(39).

    (33) is the mean over M points; in (36) the normal is the last row of the transposed V, see docs/errata.md.

    Args:
        points_E: in the tool's frame, m, shape (k, 3).
        limits: None are the paper's radius of 0.1 m and the defaults of `SurfaceLimits`.

    Returns:
        The estimate. One that is not valid says that nothing is there: distance is the reach, the normal lies against
        the tool's axis.
    """
    limits = limits or SurfaceLimits()
    near = points_E[:, 0] ** 2 + points_E[:, 1] ** 2 <= limits.radius**2  # (30)
    patch = points_E[near]
    count = len(patch)
    if count < max(limits.points, 3):
        return _nothing(count, np.inf, limits)
    centre = patch.mean(axis=0)  # (33)
    _, sizes, Vt = np.linalg.svd(patch - centre, full_matrices=False)  # (34)-(35)
    n_E = Vt[2]  # (36)-(37)
    if n_E[2] > 0.0:
        n_E = -n_E
    _, spread, residual = sizes / np.sqrt(count)
    if residual > limits.residual or spread < limits.spread or -n_E[2] < limits.slope:
        return _nothing(count, float(residual), limits)
    distance = float(centre @ n_E / n_E[2])  # (38)
    if distance > limits.reach:
        return _nothing(count, float(residual), limits)
    return SurfaceEstimate(distance, n_E, count, float(residual), True)


def _nothing(count: int, residual: float, limits: SurfaceLimits) -> SurfaceEstimate:
    return SurfaceEstimate(limits.reach, np.array([0.0, 0.0, -1.0]), count, residual, False)


class SurfaceEstimator:
    """From a frame of the depth camera to the signals of a loop.

    Attributes:
        limits: which points and planes are believed.
    """

    def __init__(self, p_EC: Array, R_EC: Array, R_BE: Array, limits: SurfaceLimits | None = None) -> None:
        """Take the calibration.

        Args:
            p_EC: position of the camera in the tool's frame, m, shape (3,).
            R_EC: its attitude there, shape (3, 3).
            R_BE: attitude of the tool in the base, shape (3, 3).
            limits: None are the defaults.
        """
        self._p_EC, self._R_EC, self._R_BE = p_EC, R_EC, R_BE
        self.limits = limits or SurfaceLimits()

    def estimate(self, points_C: Array) -> SurfaceEstimate:
        """Fit a plane to points in the camera's frame, m, shape (k, 3), moved to the tool's by (31)."""
        return fit_surface(points_C @ self._R_EC.T + self._p_EC, self.limits)

    def signals(self, points_C: Array, q_WB: Array) -> dict[str, Array]:
        """What a loop serves.

        Args:
            points_C: of one frame, m, shape (k, 3).
            q_WB: attitude of the base at that time, as estimated, wxyz, shape (4,).

        Returns:
            surface_distance (m, shape (1,)), n_W (unit, towards the robot, shape (3,)), surface_valid (shape (1,)).
        """
        found = self.estimate(points_C)
        return {
            "surface_distance": np.array([found.distance]),
            "n_W": Rotation.from_quat(q_WB, scalar_first=True).apply(self._R_BE @ found.n_E),
            "surface_valid": np.array([float(found.valid)]),
        }
