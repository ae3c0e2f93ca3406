"""Inspection: the survey against the block as it stands, the nine points, what the metrics count."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.exceptions import InputError
from aerotact.experiments.bodie2021.inspection import FORCE, POINTS, SERIES, SPACING, WORLD, Inspection, points
from aerotact.experiments.survey import survey
from aerotact.flight import fly
from aerotact.log import Log
from aerotact.plant.plant import Plant
from aerotact.ports import Array
from aerotact.robot import load_robot

INSPECTION = Inspection()


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(load_robot(INSPECTION.robot), WORLD)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(load_robot(INSPECTION.robot))


def _face(plant: Plant) -> tuple[Array, Array]:
    """A point of the block's face and the face's normal, towards the robot, from the plant's geometry."""
    geom = mujoco.mj_name2id(plant.model, mujoco.mjtObj.mjOBJ_GEOM, "surface_block")
    n_W = -plant.data.geom_xmat[geom].reshape(3, 3)[:, 0]
    return plant.data.geom_xpos[geom] + plant.model.geom_size[geom][0] * n_W, n_W


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_survey_finds_the_block_within_2_mm_and_1_degree(plant: Plant, model: Model, seed: int) -> None:
    p_W, n_W = _face(plant)
    found = survey(INSPECTION.robot, WORLD, seed)
    assert abs((found.p_W - p_W) @ n_W) < 2e-3
    assert np.degrees(np.arccos(min(found.n_W @ n_W, 1.0))) < 1.0
    np.testing.assert_allclose(found.p_W[1:], model.hover_tool[0][1:], atol=1e-9)  # straight ahead of the tool


def test_survey_is_as_noisy_as_the_camera() -> None:
    assert not np.array_equal(survey(INSPECTION.robot, WORLD, 0).n_W, survey(INSPECTION.robot, WORLD, 1).n_W)


def test_survey_needs_a_camera_and_something_to_see() -> None:
    with pytest.raises(InputError, match="no depth camera"):
        survey("tilt_hex", WORLD)
    with pytest.raises(InputError, match="no plane from hover in world 'floor'"):
        survey(INSPECTION.robot, "floor")


def test_nine_points_lie_in_a_level_row_on_the_block_5_cm_apart(plant: Plant) -> None:
    p_W, n_W = _face(plant)
    found = np.array([contact.p_WE for contact in points(INSPECTION.robot)])
    assert len(found) == POINTS == 9
    np.testing.assert_allclose(np.linalg.norm(np.diff(found, axis=0), axis=1), SPACING, rtol=1e-9)
    np.testing.assert_allclose(found[:, 2], found[0, 2], atol=1e-9)
    assert np.abs((found - p_W) @ n_W).max() < 6e-3  # 2 mm, and 1 degree over 0.2 m
    assert [len(case.doc) > 0 for case in INSPECTION.cases] == [True] * 3


def test_flights_share_out_the_points(model: Model) -> None:
    seen = []
    for case in INSPECTION.cases:
        middle = np.array([np.mean(SERIES.pressed(n)) for n in range(SERIES.count)])
        seen += list(INSPECTION.reference(case, model).sample(middle)["p_WE_d"])
    np.testing.assert_allclose(seen, [contact.p_WE for contact in points(INSPECTION.robot)], atol=1e-12)


@pytest.fixture
def steady(model: Model) -> dict[str, Array]:
    """Columns of a flight in which the tip slides 3 mm to each side and the force is 1 N too high."""
    time = np.arange(0.0, SERIES.end, 0.01)
    wanted = INSPECTION.reference(INSPECTION.cases[0], model).sample(time)
    contact = points(INSPECTION.robot)[0]
    level_W = np.cross(contact.n_W, [0.0, 0.0, 1.0])
    slide = 0.003 * np.sign(np.sin(2 * np.pi * time))[:, None] * level_W / np.linalg.norm(level_W)
    force = (wanted["f_ref"] > 0) * (wanted["f_ref"] + 1.0)
    return {
        "time": time[:, None],
        "p_WE": wanted["p_WE_d"] + slide,
        "q_WE": wanted["q_WE_d"],
        **{name: wanted[name] for name in ("p_WE_d", "q_WE_d", "f_ref")},
        "n_W": np.tile(contact.n_W, (len(time), 1)),
        "f_contact_W": force * contact.n_W,
    }


def test_metrics_of_a_flight_that_is_known(steady: dict[str, Array]) -> None:
    found = INSPECTION.metrics(INSPECTION.cases[0], Log(0.01, steady, {}, {}))
    assert found["held"].value == 1.0
    assert found["force_mean"].value == pytest.approx(FORCE + 1.0)
    assert found["force_true"].value == pytest.approx(1.0)
    assert found["force_band"].value == pytest.approx(1.0, abs=1e-3)
    assert found["spread"].value == pytest.approx(0.003, rel=0.01)
    assert found["off_point"].value == pytest.approx(0.003, rel=0.01)


def test_figures_are_drawn(steady: dict[str, Array], tmp_path: Path) -> None:
    name = INSPECTION.cases[0].name
    files = INSPECTION.plot({("law", name): steady, ("mpc", name): steady}, tmp_path)
    assert [file.name for file in files] == ["points.png", "force.png"]
    assert all(file.stat().st_size > 10_000 for file in files)


@pytest.mark.slow
def test_the_law_holds_three_points_at_5_n() -> None:
    _, result = fly(INSPECTION, INSPECTION.cases[1], "law", 0)
    assert result.fault == ""
    assert result.metrics["held"].value == 1.0
    assert result.metrics["force_mean"].value == pytest.approx(FORCE, abs=0.25)
