"""Undulating wall: contacts and ways on the map, what the metrics count, the figures, and flights."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.undulating_wall import (
    CONTACTS,
    FORCE,
    JUDGED,
    SERIES,
    WORLD,
    UndulatingWall,
    contacts,
    trials,
)
from aerotact.experiments.surface_map import SurfaceMap, map_surfaces
from aerotact.flight import fly
from aerotact.log import Log
from aerotact.plant.plant import Plant
from aerotact.plant.undulating_wall import FACE, SPRINGY, TILES, Y, Z, elevation
from aerotact.ports import Array
from aerotact.robot import load_robot

WALL = UndulatingWall()


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(load_robot(WALL.robot))


@pytest.fixture(scope="module")
def surface() -> SurfaceMap:
    return map_surfaces(Plant(load_robot(WALL.robot), WORLD))


@pytest.fixture
def perfect(model: Model) -> dict[str, Array]:
    """Columns of a flight over the first strip in which all is as wanted, at 100 Hz."""
    time = np.arange(0.0, SERIES.end, 0.01)
    wanted = WALL.reference(WALL.cases[0], model).sample(time)
    n_W = -Rotation.from_quat(wanted["q_WE_d"], scalar_first=True).as_matrix()[:, :, 2]
    off = np.min([np.linalg.norm(wanted["p_WE_d"] - c.p_WE, axis=1) for c in contacts(WALL.robot)[0]], axis=0)
    return {
        "time": time[:, None],
        **{name: wanted[f"{name}_d"].copy() for name in ("p_WE", "q_WE")},
        **{name: wanted[name] for name in ("p_WE_d", "q_WE_d", "f_ref")},
        "n_W": n_W,
        "f_contact_W": wanted["f_ref"] * n_W,
        "surface_distance": off[:, None],
    }


def test_there_are_42_contacts_all_over_the_wall_and_one_on_the_springy_spot() -> None:
    found = [contact for strip in contacts(WALL.robot) for contact in strip]
    assert len(found) == CONTACTS == 42
    assert [len(strip) for strip in contacts(WALL.robot)] == [SERIES.count] * len(WALL.cases)
    points = np.array([contact.p_WE for contact in found])
    np.testing.assert_allclose(points[:, 0], FACE - elevation(points[:, 1], points[:, 2]), atol=3e-4)
    assert np.linalg.norm(points[:, None] - points, axis=2)[np.triu_indices(42, 1)].min() > 0.005
    tiles = [
        ((points[:, k] - span[0]) // ((span[1] - span[0]) / n)).astype(int)
        for k, span, n in zip((1, 2), (Y, Z), TILES, strict=True)
    ]
    assert len({*zip(*tiles, strict=True)}) > 15
    assert ((tiles[0] == SPRINGY[0]) & (tiles[1] == SPRINGY[1])).sum() == 1


def test_contacts_are_the_same_each_time() -> None:
    before = contacts(WALL.robot)
    contacts.cache_clear()
    again = contacts(WALL.robot)
    assert before is not again
    for a, b in zip(before[3], again[3], strict=True):
        np.testing.assert_array_equal(a.p_WE, b.p_WE)


@pytest.mark.parametrize("number", range(len(WALL.cases)))
def test_ways_between_contacts_are_clear_of_the_wall(number: int, model: Model, surface: SurfaceMap) -> None:
    """Wherever the tool is not on its way to a contact or back, it is 10 cm off; and it never is behind the face."""
    time = np.arange(4.0, SERIES.end, 0.05)
    wanted = WALL.reference(WALL.cases[number], model).sample(time)
    inside = wanted["p_WE_d"][np.abs(wanted["p_WE_d"][:, 1]) < 0.9]
    points, normals = surface.closest(inside)
    assert ((inside - points) * normals).sum(axis=1).min() > -1e-6
    spans = [(SERIES.pressed(n)[0] - 2.5, SERIES.pressed(n)[1] + 1.5) for n in range(SERIES.count)]
    between = np.all([(time < a) | (time > b) for a, b in spans], axis=0)
    points, _ = surface.closest(wanted["p_WE_d"][between])
    assert np.linalg.norm(points - wanted["p_WE_d"][between], axis=1).min() > 0.1


def test_metrics_of_a_perfect_flight_and_of_one_contact_lost(perfect: dict[str, Array]) -> None:
    log = Log(0.01, perfect, {}, {})
    found = WALL.metrics(WALL.cases[0], log)
    assert found["held"].value == 1.0
    for name in ("force_error", "tool_across", "attitude_max", "contact_airborne"):
        assert found[name].value == pytest.approx(0.0, abs=1e-6)
    assert found["contact_peak"].value == pytest.approx(FORCE)
    rows = log.window(SERIES.held(2)[1] - JUDGED, SERIES.held(2)[1])
    perfect["f_contact_W"][rows] *= 0.0
    found = WALL.metrics(WALL.cases[0], log)
    assert found["held"].value == pytest.approx(6 / 7)
    assert found["force_error"].value == pytest.approx(FORCE / 7)
    assert found["force_bias"].value == pytest.approx(-FORCE / 7)
    assert found["contact_airborne"].value == pytest.approx(1 / 7)


def test_trials_are_in_the_order_of_their_pitch_as_planned(perfect: dict[str, Array]) -> None:
    found = trials([perfect])
    pitch = [trial.pitch for trial in found]
    planned = sorted(-np.degrees(np.arcsin(contact.n_W[2])) for contact in contacts(WALL.robot)[0])
    np.testing.assert_allclose(pitch, planned, atol=1e-6)
    assert all(trial.held for trial in found)
    assert all(trial.across.size > 500 for trial in found)  # at least the 5 s on the wall


def test_figures_are_drawn_from_some_of_the_flights(perfect: dict[str, Array], tmp_path: Path) -> None:
    files = WALL.plot({("law", "strip1"): perfect, ("mpc", "strip1"): perfect}, tmp_path)
    assert [file.name for file in files] == ["fig15.png", "fig16.png", "fig17.png"]
    assert all(file.stat().st_size > 10_000 for file in files)


@pytest.mark.slow
@pytest.mark.parametrize("case", [WALL.cases[1], WALL.cases[4]], ids=lambda case: case.name)
def test_the_law_holds_the_contacts_of_a_strip(case: object) -> None:
    _, result = fly(WALL, case, "law", 0)  # type: ignore[arg-type]
    assert result.fault == ""
    assert result.metrics["held"].value == 1.0
    assert result.metrics["violations_thrust"].value == 0
