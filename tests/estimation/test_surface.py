"""The plane ahead of the tool, bodie2021 (30)-(39): exact on planes, accurate in MuJoCo, doubtful where it must be."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.estimation.surface import SurfaceEstimator, SurfaceLimits, fit_surface
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.plant.surface import SurfaceAhead
from aerotact.ports import Array
from aerotact.robot import load_robot

OCTOROTOR = Path(__file__).parents[1] / "fixtures" / "octorotor"


def _plane(distance: float, n_E: Array, count: int = 2000, noise: float = 0.0, seed: int = 0) -> Array:
    """Points of a plane that cuts the tool's axis at a distance, within 0.2 m of the axis."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.2, 0.2, (count, 2))
    z = distance - xy @ n_E[:2] / n_E[2] + noise * rng.normal(size=count)
    return np.column_stack([xy, z])


def _unit(*values: float) -> Array:
    return np.array(values) / np.linalg.norm(values)


@pytest.mark.parametrize("n_E", [_unit(0, 0, -1), _unit(0.4, -0.3, -1), _unit(-1, 0.5, -0.8)], ids=str)
@pytest.mark.parametrize("distance", [-0.004, 0.0, 0.37, 2.0])
def test_exact_plane_is_found(distance: float, n_E: Array) -> None:
    found = fit_surface(_plane(distance, n_E))
    assert found.valid
    assert found.distance == pytest.approx(distance, abs=1e-12)
    np.testing.assert_allclose(found.n_E, n_E, atol=1e-12)
    assert found.residual < 1e-12


def test_only_points_within_the_radius_count() -> None:
    """(30): a step 0.11 m beside the axis is not seen; the number of points is that of the circle."""
    points = _plane(0.5, _unit(0, 0, -1), count=20000)
    beyond = np.hypot(points[:, 0], points[:, 1]) > 0.11
    points[beyond, 2] += 0.3
    found = fit_surface(points)
    assert found.distance == pytest.approx(0.5, abs=1e-12)
    assert found.points == (np.hypot(points[:, 0], points[:, 1]) <= 0.1).sum()
    assert found.points == pytest.approx(20000 * np.pi / 16, rel=0.05)


def test_mean_of_33_is_over_as_many_points_as_are_summed() -> None:
    """As printed, points 0 to M over M, a plane at 1 m comes out further away by 1/M."""
    points = _plane(1.0, _unit(0, 0, -1), count=60)
    found = fit_surface(points, SurfaceLimits(points=3))
    assert 5 <= found.points < 30
    assert found.distance == pytest.approx(1.0, abs=1e-12)
    assert points[:, 2].sum() / (len(points) - 1) > 1.01


def test_last_column_of_numpys_third_factor_is_no_normal() -> None:
    """(35)-(36): numpy returns V transposed."""
    n_E = _unit(0.4, -0.3, -1)
    patch = _plane(0.0, n_E)
    _, _, Vt = np.linalg.svd(patch - patch.mean(axis=0), full_matrices=False)
    assert abs(Vt[2] @ n_E) == pytest.approx(1.0, abs=1e-12)
    assert abs(Vt[:, 2] @ n_E) < 0.999


DOUBTFUL = {
    "no points": np.zeros((0, 3)),
    "too few points": _plane(0.5, _unit(0, 0, -1), count=40),
    "points on a line": np.column_stack([np.linspace(-0.1, 0.1, 500), np.zeros(500), np.full(500, 0.5)]),
    "a step": np.vstack([_plane(0.4, _unit(0, 0, -1)), _plane(0.6, _unit(0, 0, -1))]),
    "along the axis": _plane(0.5, _unit(1, 0, -0.2)),
    "too far": _plane(4.1, _unit(0, 0, -1)),
}


@pytest.mark.parametrize("case", DOUBTFUL)
def test_doubtful_planes_are_far_away(case: str) -> None:
    found = fit_surface(DOUBTFUL[case])
    assert not found.valid
    assert found.distance == SurfaceLimits().reach
    np.testing.assert_array_equal(found.n_E, [0, 0, -1])


def test_camera_finds_the_wall_within_2_mm_and_1_degree() -> None:
    """The project's bound, with the noise of the camera, at poses up to 0.4 m off the wall and 25 degrees askew."""
    robot = load_robot(OCTOROTOR)
    plant, rng = Plant(robot, "wall"), np.random.default_rng(11)
    camera = Sensors(plant, robot, seed=11).depth_camera
    assert camera is not None
    estimator, ahead = SurfaceEstimator(camera.p_EC, camera.R_EC, robot.R_BE), SurfaceAhead(plant, 4.0)
    errors = []
    for _ in range(300):
        turn = Rotation.from_euler("ZYX", rng.uniform(-25, 25, 3), degrees=True)
        arm = turn.apply(robot.p_BE)
        tip = np.array([1.0 - rng.uniform(0.0, 0.4), *rng.uniform([-0.4, 1.0], [0.4, 1.6])])
        q_WB = turn.as_quat(scalar_first=True)
        plant.reset(tip - arm, q_WB)
        true, found = ahead.sample(), estimator.signals(camera.points(), q_WB)
        assert found["surface_valid"] == true["surface_valid"] == 1.0
        angle = np.arccos(np.clip(found["n_W"] @ true["n_W"], -1.0, 1.0))
        along = found["surface_distance"] - true["surface_distance"]
        assert np.linalg.norm(found["n_W"]) == pytest.approx(1.0, abs=1e-12)
        errors.append([abs(along[0]), angle])
    distance, angle = np.array(errors).T
    assert distance.max() < 2e-3
    assert angle.max() < np.radians(1.0)
    assert distance.max() > 1e-5  # there is noise
