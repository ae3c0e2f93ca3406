"""PointPatch: what a frame of the depth camera comes to, the points about the tool's axis, bodie2021 (30)-(34)."""

import numpy as np

from aerotact.ports import Array

RADIUS = 0.1
"""d_pi of (30), the paper's radius of the cylinder about the tool's axis, m."""


def point_patch(points_C: Array, p_EC: Array, R_EC: Array, radius: float = RADIUS) -> dict[str, Array]:
    """Number, mean and covariance of the points about the tool's axis: all that the plane of (35)-(39) needs.

    Args:
        points_C: one frame, in the camera's frame, m, shape (k, 3); k may be 0.
        p_EC, R_EC: pose of the camera in the tool's frame, m, shapes (3,) and (3, 3).
        radius: points further from the tool's axis than this are left out, m.

    Returns:
        patch_points: number of points M of (32), shape (1,);
        patch_mean_E: their mean, (33) with the sum over M points, m, shape (3,);
        patch_covariance_E: mean of the products of (34), xx, xy, xz, yy, yz, zz, m2, shape (6,).
        Without points all are zero.
    """
    points_E = points_C @ R_EC.T + p_EC  # (31)
    patch = points_E[points_E[:, 0] ** 2 + points_E[:, 1] ** 2 <= radius**2]  # (30)
    count = len(patch)
    if count == 0:
        return {"patch_points": np.zeros(1), "patch_mean_E": np.zeros(3), "patch_covariance_E": np.zeros(6)}
    mean = patch.mean(axis=0)
    unbiased = patch - mean
    products = unbiased.T @ unbiased / count
    return {
        "patch_points": np.array([float(count)]),
        "patch_mean_E": mean,
        "patch_covariance_E": products[np.triu_indices(3)],
    }
