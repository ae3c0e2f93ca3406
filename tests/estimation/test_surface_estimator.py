"""The plane ahead of the tool, bodie2021 (35)-(39): exact on planes, as numpy's SVD has it, accurate in MuJoCo."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.point_patch import point_patch
from aerotact.estimation.surface_estimator import REACH, surface_estimator
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.plant.surface import SurfaceAhead
from aerotact.ports import Array

RATE = 500.0
Estimate = Callable[[Array, Array], dict[str, Array]]


@pytest.fixture(scope="module")
def octorotor(models: dict[str, Model]) -> Model:
    return models["octorotor"]


@pytest.fixture(scope="module")
def estimate(octorotor: Model) -> Estimate:
    """From points in E and the attitude of the base to the block's outputs."""
    block = surface_estimator(octorotor, RATE)

    def step(points_E: Array, q_WB: Array) -> dict[str, Array]:
        y = block.measurement.pack({"q_WB": q_WB, **point_patch(points_E, np.zeros(3), np.eye(3))})
        _, u = block.step(block.state.default, y, block.reference.default, block.parameters.default)
        return block.output.unpack(u.full())

    return step


def _plane(distance: float, n_E: Array, count: int = 2000, noise: float = 0.0) -> Array:
    """Points of a plane that cuts the tool's axis at a distance, within 0.2 m of the axis."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(-0.2, 0.2, (count, 2))
    z = distance - xy @ n_E[:2] / n_E[2] + noise * rng.normal(size=count)
    return np.column_stack([xy, z])


def _unit(*values: float) -> Array:
    return np.array(values) / np.linalg.norm(values)


def _level(model: Model) -> Array:
    """Attitude of the base at which E has W's axes."""
    return np.asarray(Rotation.from_matrix(model.robot.R_BE.T).as_quat(scalar_first=True))


@pytest.mark.parametrize("n_E", [_unit(0, 0, -1), _unit(0.4, -0.3, -1), _unit(-1, 0.5, -0.8)], ids=str)
@pytest.mark.parametrize("distance", [-0.004, 0.0, 0.37, 2.0])
def test_exact_plane_is_found(distance: float, n_E: Array, estimate: Estimate, octorotor: Model) -> None:
    found = estimate(_plane(distance, n_E), _level(octorotor))
    assert found["surface_valid"] == 1.0
    assert found["surface_distance"] == pytest.approx(distance, abs=1e-9)
    np.testing.assert_allclose(found["n_W"], n_E, atol=1e-9)


def test_plane_is_that_of_the_singular_value_decomposition(estimate: Estimate, octorotor: Model) -> None:
    """(35)-(36) with numpy, whose third factor is V transposed: its last row, not its last column."""
    points = _plane(0.3, _unit(0.4, -0.3, -1), noise=0.01)
    patch = points[np.hypot(points[:, 0], points[:, 1]) <= 0.1]
    centre = patch.mean(axis=0)
    _, _, Vt = np.linalg.svd(patch - centre, full_matrices=False)
    normal = -Vt[2] * np.sign(Vt[2, 2])
    found = estimate(points, _level(octorotor))
    np.testing.assert_allclose(found["n_W"], normal, atol=1e-9)
    assert found["surface_distance"] == pytest.approx(centre @ normal / normal[2], abs=1e-9)
    assert abs(Vt[:, 2] @ found["n_W"]) < 0.99


def test_normal_is_turned_into_the_world(estimate: Estimate, octorotor: Model) -> None:
    n_E, rng = _unit(0.2, -0.1, -1), np.random.default_rng(2)
    for turn in Rotation.random(20, rng=rng):
        found = estimate(_plane(0.5, n_E), turn.as_quat(scalar_first=True))
        np.testing.assert_allclose(found["n_W"], turn.apply(octorotor.robot.R_BE @ n_E), atol=1e-9)


DOUBTFUL = {
    "no points": np.zeros((0, 3)),
    "too few points": _plane(0.5, _unit(0, 0, -1), count=40),
    "points on a line": np.column_stack([np.linspace(-0.1, 0.1, 500), np.zeros(500), np.full(500, 0.5)]),
    "a step": np.vstack([_plane(0.4, _unit(0, 0, -1)), _plane(0.6, _unit(0, 0, -1))]),
    "along the axis": _plane(0.5, _unit(1, 0, -0.2)),
    "too far": _plane(4.1, _unit(0, 0, -1)),
    "noise": np.random.default_rng(1).normal(size=(2000, 3)),
}


@pytest.mark.parametrize("case", DOUBTFUL)
def test_doubtful_planes_are_far_away(case: str, estimate: Estimate, octorotor: Model) -> None:
    found = estimate(DOUBTFUL[case], _level(octorotor))
    assert (found["surface_valid"], found["surface_distance"]) == (0.0, REACH)
    np.testing.assert_allclose(found["n_W"], [0, 0, -1], atol=1e-12)


def test_camera_finds_the_wall_within_2_mm_and_1_degree(octorotor: Model) -> None:
    """With the camera's noise, at 300 random poses up to 0.4 m off the wall and 25 degrees askew."""
    robot, rng = octorotor.robot, np.random.default_rng(11)
    plant, block = Plant(robot, "wall"), surface_estimator(octorotor, RATE)
    camera, ahead = Sensors(plant, robot, seed=11).depth_camera, SurfaceAhead(plant, REACH)
    assert camera is not None
    errors = []
    for _ in range(300):
        turn = Rotation.from_euler("ZYX", rng.uniform(-25, 25, 3), degrees=True)
        tip = np.array([1.0 - rng.uniform(0.0, 0.4), *rng.uniform([-0.4, 1.0], [0.4, 1.6])])
        q_WB = turn.as_quat(scalar_first=True)
        plant.reset(tip - turn.apply(robot.p_BE), q_WB)
        patch = point_patch(camera.points(), camera.p_EC, camera.R_EC)
        y = block.measurement.pack({"q_WB": q_WB, **patch})
        _, u = block.step(block.state.default, y, block.reference.default, block.parameters.default)
        true, found = ahead.sample(), block.output.unpack(u.full())
        assert found["surface_valid"] == true["surface_valid"] == 1.0
        angle = np.arccos(np.clip(found["n_W"] @ true["n_W"], -1.0, 1.0))
        errors.append([abs(found["surface_distance"] - true["surface_distance"])[0], angle])
    distance, angle = np.array(errors).T
    assert distance.max() < 2e-3
    assert angle.max() < np.radians(1.0)
    assert distance.max() > 1e-5  # there is noise
