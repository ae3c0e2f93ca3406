"""The map of the undulating wall against the wall's own formula, and contacts on it against the plant."""

import sys
from pathlib import Path

import numpy as np
import pytest

from aerotact.exceptions import InputError
from aerotact.experiments.surface_map import SurfaceMap, map_surfaces
from aerotact.plant.plant import Plant
from aerotact.plant.surface import SurfaceAhead
from aerotact.plant.undulating_wall import FACE, Y, Z, elevation
from aerotact.ports import Array
from aerotact.robot import load_robot

OCTOROTOR = Path(__file__).parents[1] / "fixtures" / "octorotor"


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(load_robot(OCTOROTOR), "undulating_wall")


@pytest.fixture(scope="module")
def surface(plant: Plant) -> SurfaceMap:
    return map_surfaces(plant)


def _wall(y: Array, z: Array) -> tuple[Array, Array]:
    """Points of the wall and their normals by the formula."""
    h = 1e-5
    dy = (elevation(y + h, z) - elevation(y - h, z)) / (2 * h)
    dz = (elevation(y, z + h) - elevation(y, z - h)) / (2 * h)
    normals = np.column_stack([-np.ones_like(y), -dy, -dz])
    return np.column_stack([FACE - elevation(y, z), y, z]), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_tiles_are_welded_to_one_sheet(surface: SurfaceMap) -> None:
    mesh = surface.mesh
    assert len(mesh.vertices) == 91 * 51
    assert len(mesh.faces) == 2 * 90 * 50
    assert mesh.body_count == 1
    assert (mesh.face_normals[:, 0] < -0.8).all()
    np.testing.assert_allclose(mesh.bounds[:, 1:], np.transpose([Y, Z]), atol=1e-9)


def test_closest_points_lie_on_the_wall_and_normals_are_its_own(surface: SurfaceMap) -> None:
    rng = np.random.default_rng(5)
    on, normal = _wall(rng.uniform(-0.8, 0.8, 300), rng.uniform(0.8, 1.6, 300))
    away = rng.uniform(-0.05, 0.2, (300, 1))  # less than the radius of curvature
    found, n_W = surface.closest(on + away * normal)
    facet = np.tan(np.radians(1.6))  # largest angle between a facet and the smooth wall
    assert (np.linalg.norm(found - on, axis=1) <= 2e-4 + facet * np.abs(away[:, 0])).all()
    _, normal = _wall(found[:, 1], found[:, 2])
    assert np.degrees(np.arccos(np.clip((n_W * normal).sum(axis=1), -1, 1))).max() < 0.25


def test_closest_is_closer_than_any_vertex(surface: SurfaceMap) -> None:
    points = np.random.default_rng(6).uniform([0.3, -1.0, 0.5], [1.3, 1.0, 1.9], (100, 3))
    found, _ = surface.closest(points)
    nearest = np.linalg.norm(points[:, None] - surface.mesh.vertices, axis=2).min(axis=1)
    assert (np.linalg.norm(found - points, axis=1) <= nearest + 1e-12).all()


def test_random_contacts_stand_on_the_plants_wall(plant: Plant, surface: SurfaceMap) -> None:
    """The true surface is met at distance 0, straight ahead, by a body without roll; 42 as in bodie2021 V-F."""
    robot, ahead = plant.robot, SurfaceAhead(plant, 4.0)
    contacts = surface.random_contacts(42, seed=1)
    assert len(contacts) == 42
    for contact in contacts:
        plant.reset(*contact.base(robot.p_BE, robot.R_BE))
        true = ahead.sample()
        assert abs(true["surface_distance"][0]) < 1e-5  # tiles are written to 1e-4 of their height
        assert true["n_W"] @ contact.n_W > np.cos(np.radians(2.0))  # a facet's normal against a smooth one
        assert Y[0] + 0.09 < contact.p_WE[1] < Y[1] - 0.09
        assert Z[0] + 0.09 < contact.p_WE[2] < Z[1] - 0.09
    points = np.array([c.p_WE for c in contacts])
    assert (np.ptp(points[:, 1:], axis=0) > [1.2, 0.6]).all()
    again = surface.random_contacts(42, seed=1)
    np.testing.assert_array_equal(points, [c.p_WE for c in again])
    assert not np.allclose(points[0], surface.random_contacts(1, seed=2)[0].p_WE)


def test_what_cannot_be_mapped_is_refused(surface: SurfaceMap, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no height field"):
        map_surfaces(Plant(load_robot(OCTOROTOR), "wall"))
    with pytest.raises(InputError, match="0 of 3 contacts at 2 m from the rim"):
        surface.random_contacts(3, seed=0, margin=2.0)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(InputError, match=r"pip install \"aerotact\[mesh\]\""):
        SurfaceMap(np.eye(3), np.array([[0, 1, 2]]))
