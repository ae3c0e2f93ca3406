"""Contact series: when what happens, what is wanted on the surface, and what counts as held."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.experiments.bodie2021.contact_series import ContactSeries, judge, tool_errors
from aerotact.experiments.contact_pose import contact_pose
from aerotact.ports import Array

SERIES = ContactSeries(2, 10.0, 5.0, transfer=2.5, stand_off=0.25)
TIME = np.arange(0.0, SERIES.end, 0.01)
HOVER = (np.array([0.5, 0.0, 1.5]), np.array([0.7071067811865476, 0.0, 0.7071067811865476, 0.0]))
CONTACTS = [contact_pose(np.array([1.0, y, 1.3]), np.array([-1.0, 0.2, 0.3])) for y in (-0.1, 0.2)]
LAST = 2.5


@pytest.fixture
def wanted() -> dict[str, Array]:
    return dict(SERIES.reference(HOVER, CONTACTS).sample(TIME))


@pytest.fixture
def perfect(wanted: dict[str, Array]) -> dict[str, Array]:
    """Columns of a log in which all is as wanted."""
    n_W = CONTACTS[0].n_W
    return {
        "time": TIME[:, None],
        **{name: wanted[f"{name}_d"].copy() for name in ("p_WE", "q_WE")},
        **{name: wanted[name] for name in ("p_WE_d", "q_WE_d", "f_ref")},
        "n_W": np.tile(n_W, (len(TIME), 1)),
        "f_contact_W": wanted["f_ref"] * n_W,
    }


def _inside(number: int) -> int:
    """A row in the middle of the judged time."""
    return int(np.searchsorted(TIME, SERIES.held(number)[1] - LAST / 2))


@pytest.mark.parametrize("number", [0, 1])
def test_the_tool_rests_on_the_surface_while_a_force_is_wanted(wanted: dict[str, Array], number: int) -> None:
    start, stop = SERIES.pressed(number)
    assert stop - start == pytest.approx(SERIES.duration)
    rows = (start - 0.4 <= TIME) & (stop > TIME)
    np.testing.assert_allclose(wanted["p_WE_d"][rows], np.tile(CONTACTS[number].p_WE, (rows.sum(), 1)), atol=1e-12)
    for name in ("v_WE_d", "w_E_d", "a_WE_d", "dw_E_d"):  # (45)
        assert np.abs(wanted[name][rows]).max() < 1e-12
    force = wanted["f_ref"][:, 0]
    held = (SERIES.held(number)[0] <= TIME) & (SERIES.held(number)[1] > TIME)
    assert (force[held] == SERIES.force).all()
    assert held.sum() == pytest.approx(0.8 * 500, abs=1)  # 80 % of the duration at 100 Hz


def test_no_force_is_wanted_off_the_surface(wanted: dict[str, Array]) -> None:
    outside = np.all([(a > TIME) | (b <= TIME) for a, b in map(SERIES.pressed, range(2))], axis=0)
    assert np.abs(wanted["f_ref"][outside]).max() == 0.0
    off = np.min([np.linalg.norm(wanted["p_WE_d"] - c.p_WE, axis=1) for c in CONTACTS], axis=0)
    assert off[outside].max() > 0.24


def test_set_points_change_at_100_hz(wanted: dict[str, Array]) -> None:
    fine = SERIES.reference(HOVER, CONTACTS).sample(np.arange(6.0, 7.0, 1e-3) + 5e-4)
    assert len(np.unique(fine["p_WE_d"][:, 0])) == 100
    assert SERIES.end == pytest.approx(4.0 + 2 * SERIES.period)


def test_a_perfect_contact_is_held(perfect: dict[str, Array]) -> None:
    for number in (0, 1):
        contact = judge(perfect, SERIES, number, LAST)
        assert contact.held
        assert contact.airborne == 0.0
        assert contact.peak == pytest.approx(10.0)
        np.testing.assert_allclose(contact.force, 10.0)
        np.testing.assert_allclose(contact.band, 10.0, atol=1e-3)
        assert contact.across.max() < 1e-12
        assert contact.attitude.max() < 1e-7


def test_one_row_without_contact_is_not_held(perfect: dict[str, Array]) -> None:
    perfect["f_contact_W"][_inside(1)] = 0.0
    assert judge(perfect, SERIES, 0, LAST).held
    contact = judge(perfect, SERIES, 1, LAST)
    assert not contact.held
    assert contact.airborne == pytest.approx(1 / 250, rel=0.01)


@pytest.mark.parametrize(("off", "held"), [(0.045, True), (0.055, False)])
def test_a_tool_beside_its_point_is_not_held(perfect: dict[str, Array], off: float, held: bool) -> None:
    across_W = Rotation.from_quat(CONTACTS[0].q_WE, scalar_first=True).as_matrix()[:, 1]
    perfect["p_WE"][_inside(0)] += off * across_W + 0.5 * CONTACTS[0].n_W  # along its axis it may be anywhere
    contact = judge(perfect, SERIES, 0, LAST)
    assert contact.held == held
    assert np.abs(contact.across[:, 1]).max() == pytest.approx(off)


@pytest.mark.parametrize(("angle", "held"), [(9.0, True), (11.0, False)])
def test_a_tool_that_turns_away_is_not_held(perfect: dict[str, Array], angle: float, held: bool) -> None:
    turned = Rotation.from_quat(perfect["q_WE"][_inside(0)], scalar_first=True) * Rotation.from_rotvec(
        [0, np.radians(angle), 0]
    )
    perfect["q_WE"][_inside(0)] = turned.as_quat(scalar_first=True)
    contact = judge(perfect, SERIES, 0, LAST)
    assert contact.held == held
    assert np.degrees(contact.attitude.max()) == pytest.approx(angle)


def test_the_peak_of_the_landing_counts_and_that_of_the_neighbour_does_not(perfect: dict[str, Array]) -> None:
    landing = int(np.searchsorted(TIME, SERIES.pressed(1)[0] - 1.0))
    perfect["f_contact_W"][landing] = 77.0 * CONTACTS[0].n_W
    assert judge(perfect, SERIES, 1, LAST).peak == pytest.approx(77.0)
    assert judge(perfect, SERIES, 0, LAST).peak == pytest.approx(10.0)


def test_tool_errors_are_in_the_axes_of_the_desired_tool(perfect: dict[str, Array]) -> None:
    x_W, y_W, z_W = Rotation.from_quat(CONTACTS[0].q_WE, scalar_first=True).as_matrix().T
    rows = {name: perfect[name][-5:].copy() for name in ("p_WE", "p_WE_d", "q_WE", "q_WE_d")}
    rows["q_WE_d"][:] = CONTACTS[0].q_WE
    rows["p_WE"] = rows["p_WE_d"] + 0.01 * x_W - 0.02 * y_W + 0.3 * z_W
    np.testing.assert_allclose(tool_errors(rows)[0], np.tile([0.01, -0.02], (5, 1)), atol=1e-12)
