"""The undulating wall: the file is what the module writes, the shape the formula's, the tiles give way as springs."""

import mujoco
import numpy as np
import pytest
from hand import Hand

from aerotact.plant.plant import Plant
from aerotact.plant.undulating_wall import (
    FACE,
    FILE,
    FRICTION,
    SPRINGY,
    SPRINGY_STIFFNESS,
    STIFFNESS,
    TILES,
    Y,
    Z,
    elevation,
    stiffness,
    world_xml,
)
from aerotact.robot import Robot


def test_file_is_what_the_module_writes() -> None:
    assert FILE.read_text(encoding="utf-8") == world_xml()


def test_shape_is_that_of_the_formula(octorotor: Robot) -> None:
    """Rays along x: within the sagitta of a cell, 0.2 mm, on all tiles and across their seams."""
    plant, rng = Plant(octorotor, "undulating_wall"), np.random.default_rng(0)
    hit = np.zeros(1, np.int32)
    tiles = set()
    for y, z in zip(rng.uniform(*Y, 500), rng.uniform(*Z, 500), strict=True):
        start = np.array([0.9, y, z])
        distance = mujoco.mj_ray(plant.model, plant.data, start, np.array([1.0, 0, 0]), None, True, plant.base_id, hit)
        assert 0.9 + distance == pytest.approx(FACE - elevation(y, z), abs=2e-4)
        tiles.add(plant.model.geom(hit[0]).name)
    assert len(tiles) == TILES[0] * TILES[1]
    assert all(name.startswith("surface_tile") for name in tiles)


def test_one_tile_is_springy() -> None:
    springs = stiffness()
    assert springs[SPRINGY] == SPRINGY_STIFFNESS
    others = np.delete(springs.ravel(), np.ravel_multi_index(SPRINGY, TILES))
    assert others.min() >= STIFFNESS[0]
    assert others.max() <= STIFFNESS[1]
    assert others.max() / others.min() > 5


@pytest.mark.parametrize("tile", [SPRINGY, (2, 2)])
def test_tile_gives_way_by_force_over_stiffness(tile: tuple[int, int], octorotor: Robot) -> None:
    """A hand presses the tool for 2 s; force of the contact along x over the tile's spring."""
    plant = Plant(octorotor, "undulating_wall", disturbances=[Hand(np.array([10.0, 0, 0]), np.zeros(3), 0.0)])
    at = [np.linspace(*span, n + 1)[k : k + 2].mean() for span, n, k in zip((Y, Z), TILES, tile, strict=True)]
    tip = np.array([FACE - elevation(*at) - 0.004, *at])
    plant.reset(tip - octorotor.p_BE)
    push, rows = [], []
    for _ in range(3000):
        plant.step()
        push.append(-plant.truth()["f_contact_W"][0])
        rows.append(-plant.data.joint(f"tile{tile[0]}{tile[1]}").qpos[0])
    force, depth = np.mean(push[-500:]), np.mean(rows[-500:])
    assert force == pytest.approx(10.0, rel=0.2)
    assert depth == pytest.approx(force / stiffness()[tile], rel=0.03)


def test_friction_is_left_to_the_plant(octorotor: Robot) -> None:
    model = Plant(octorotor, "undulating_wall").model
    tiles = [g for g in range(model.ngeom) if model.geom(g).name.startswith("surface")]
    assert len(tiles) == 30
    assert (model.geom_condim[tiles] == 1).all()
    assert (model.geom_friction[tiles, 0] == FRICTION).all()
