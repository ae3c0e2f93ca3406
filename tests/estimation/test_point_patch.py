"""The points about the tool's axis, bodie2021 (30)-(34)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.estimation.point_patch import point_patch


def test_only_points_about_the_axis_count() -> None:
    """(30)-(32), in a camera's frame that is turned and off the tool's."""
    rng = np.random.default_rng(0)
    points_E = rng.uniform([-0.2, -0.2, 0.3], [0.2, 0.2, 0.7], (5000, 3))
    R_EC = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    p_EC = np.array([-0.1, 0.05, -0.78])
    found = point_patch((points_E - p_EC) @ R_EC, p_EC, R_EC)
    inside = points_E[np.hypot(points_E[:, 0], points_E[:, 1]) <= 0.1]
    assert 800 < len(inside) < 1200
    assert found["patch_points"] == len(inside)
    np.testing.assert_allclose(found["patch_mean_E"], inside.mean(axis=0), atol=1e-12)
    matrix = np.cov(inside.T, bias=True)
    np.testing.assert_allclose(found["patch_covariance_E"], matrix[np.triu_indices(3)], atol=1e-12)


def test_mean_of_33_is_over_as_many_points_as_are_summed() -> None:
    """As printed, from 0 to M and divided by M, a plane 1 m away is 1 m/M too far."""
    angles = np.linspace(0, 2 * np.pi, 9)[:-1]
    points = np.column_stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), np.ones(8)])
    found = point_patch(points, np.zeros(3), np.eye(3))
    assert found["patch_mean_E"][2] == pytest.approx(1.0, abs=1e-15)
    assert points[:, 2].sum() / (len(points) - 1) == pytest.approx(1 + 1 / 7)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[0.2, 0.0, 0.5]])], ids=["none", "outside"])
def test_no_points_are_zeros(points: np.ndarray) -> None:
    found = point_patch(points, np.zeros(3), np.eye(3))
    assert {name: value.shape for name, value in found.items()} == {
        "patch_points": (1,),
        "patch_mean_E": (3,),
        "patch_covariance_E": (6,),
    }
    assert not np.concatenate(list(found.values())).any()
