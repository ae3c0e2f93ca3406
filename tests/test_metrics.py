"""Metrics of logs made by hand, whose answers are known."""

import numpy as np
import pytest

from aerotact.log import Log
from aerotact.metrics import FORCE_BAND, UNITS, in_band, rmse, standard_metrics, violations
from aerotact.ports import Array, Port
from aerotact.robot import Robot, load_robot

PERIOD, ROWS = 1e-3, 1000


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("tilt_hex")


def _log(robot: Robot, rows: int = ROWS, every: int = 1, **columns: Array) -> Log:
    """A hover without contact, with some columns changed."""
    hover = np.tile(robot.hover_thrust, (rows, 1))
    zero = np.zeros((rows, 3))
    plain = {
        "time": np.arange(rows)[:, None] * PERIOD,
        "thrust": hover,
        "thrust_cmd": hover,
        "thrust_rate": 0 * hover,
        "p_WE": zero,
        "p_WE_r": zero,
        "f_contact_W": zero,
    }
    ports = {name: Port(name, values.shape[1], "1") for name, values in plain.items()}
    return Log(PERIOD, {n: v.copy() for n, v in (plain | columns).items()}, ports, {}, every=every)


def _values(log: Log, robot: Robot, window: slice | None = None) -> dict[str, float | None]:
    return {name: metric.value for name, metric in standard_metrics(log, robot, window).items()}


def test_hover(robot: Robot) -> None:
    metrics = standard_metrics(_log(robot), robot)
    assert {name: metric.unit for name, metric in metrics.items()} == UNITS
    values = {name: metric.value for name, metric in metrics.items()}
    assert values["tool_rmse"] == 0.0
    assert [values[f"violations_{n}"] for n in ("thrust", "thrust_rate")] == [0, 0]
    assert [values[f"violations_{n}"] for n in ("tilt", "tilt_rate")] == [None, None]  # nothing tilts
    assert values["effort"] == pytest.approx((robot.hover_thrust**1.5).sum() * ROWS * PERIOD)
    for name in ("peak_force", "airborne", "force_rmse", "force_rmse_band", "solve_p50", "solve_max"):
        assert values[name] is None, name


@pytest.mark.parametrize(("signal", "metric"), [("tilt_cmd", "tilt"), ("tilt_rate_cmd", "tilt_rate")])
def test_tilt_violations_count_what_was_asked_of_the_servos(signal: str, metric: str) -> None:
    robot = load_robot("tilt_rotor")
    limit = {"tilt": robot.tilts[0].angle, "tilt_rate": robot.tilts[0].rate}[metric]
    plain = {name: np.zeros((ROWS, 6)) for name in ("tilt", "tilt_cmd", "tilt_rate", "tilt_rate_cmd")}
    values = plain[signal].copy()
    values[100:110, 2], values[200:203, 5], values[300, 0] = limit[1] * 1.01, limit[0] * 1.01, limit[1]
    found = _values(_log(robot, **(plain | {signal: values})), robot)
    assert found[f"violations_{metric}"] == 13
    assert sum(found[f"violations_{n}"] or 0 for n in ("thrust", "thrust_rate", "tilt", "tilt_rate")) == 13


def test_rmse_is_of_the_length_of_rows() -> None:
    assert rmse(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(5 / np.sqrt(2))
    assert rmse(np.array([1.0, -1.0])) == 1.0


def test_violations_count_rows_and_forgive_rounding() -> None:
    lower, upper = np.zeros(2), np.array([10.0, 20.0])
    values = np.array([[0, 0], [10, 20], [10 + 5e-6, -1e-5], [10.001, 20.1], [-0.001, 5], [5, 21]], dtype=float)
    assert violations(values, lower, upper) == 3


@pytest.mark.parametrize(("signal", "metric"), [("thrust", "violations_thrust"), ("thrust_cmd", "violations_thrust")])
def test_thrust_is_judged_as_commanded_and_as_it_is(robot: Robot, signal: str, metric: str) -> None:
    thrust = np.tile(robot.hover_thrust, (ROWS, 1))
    thrust[100:107, 2] = robot.rotors[2].thrust[1] + 0.01
    thrust[105:110, 4] = robot.rotors[4].thrust[0] - 0.01
    assert _values(_log(robot, **{signal: thrust}), robot)[metric] == 10


def test_thrust_rate_is_judged_on_both_sides(robot: Robot) -> None:
    rate = np.zeros((ROWS, len(robot.rotors)))
    rate[0, 0], rate[1, 1], rate[2, 2] = 80.1, -80.1, 79.9
    assert _values(_log(robot, thrust_rate=rate), robot)["violations_thrust_rate"] == 2


def test_contact(robot: Robot) -> None:
    force = np.zeros((ROWS, 3))
    force[200:700] = [0.0, 0.0, 2.0]
    force[450] = [3.0, 0.0, -4.0]
    log = _log(robot, f_contact_W=force)
    values = _values(log, robot)
    assert values["peak_force"] == 5.0
    assert values["airborne"] == 0.5
    # The peak counts wherever it is, flying only where it is judged.
    values = _values(log, robot, slice(600, 800))
    assert values["peak_force"] == 5.0
    assert values["airborne"] == 0.5
    assert _values(log, robot, slice(500, 600))["airborne"] == 0.0


def test_tool_error_is_judged_in_the_window_where_the_reference_is_fresh(robot: Robot) -> None:
    # A tool that moves at 1 m/s exactly on a reference that is given every 10 rows and held.
    moving = np.arange(ROWS)[:, None] * PERIOD * np.array([1.0, 0.0, 0.0])
    held = moving[np.arange(ROWS) // 10 * 10]
    assert _values(_log(robot, every=10, p_WE=moving, p_WE_r=held), robot)["tool_rmse"] == 0.0
    assert _values(_log(robot, every=1, p_WE=moving, p_WE_r=held), robot)["tool_rmse"] == pytest.approx(
        np.sqrt((np.arange(10) ** 2).mean()) * 1e-3
    )
    off = moving + np.array([0.0, 0.003, 0.0])
    assert _values(_log(robot, p_WE=off, p_WE_r=moving), robot)["tool_rmse"] == pytest.approx(0.003)
    off[:500] = moving[:500]
    assert _values(_log(robot, p_WE=off, p_WE_r=moving), robot, slice(0, 500))["tool_rmse"] == 0.0


def test_tool_error_of_a_controller_without_a_reference_of_its_own_is_to_what_is_desired(robot: Robot) -> None:
    log = _log(robot, p_WE=np.tile([0.0, 0.004, 0.003], (ROWS, 1)), p_WE_d=np.zeros((ROWS, 3)))
    del log.columns["p_WE_r"]
    assert _values(log, robot)["tool_rmse"] == pytest.approx(0.005)


# force


def _pressed(robot: Robot, force: Array, wanted: Array, rows: int = ROWS) -> Log:
    """A tool on a surface whose normal is (-0.6, 0, 0.8): `force` along it, and 2 N of friction."""
    n_W = np.tile([-0.6, 0.0, 0.8], (rows, 1))
    friction = np.tile([0.0, 2.0, 0.0], (rows, 1)) * (force > 0)[:, None]
    return _log(robot, rows, f_contact_W=force[:, None] * n_W + friction, n_W=n_W, f_ref=wanted[:, None])


def test_force_error_is_that_of_the_normal_force_where_one_is_wanted(robot: Robot) -> None:
    wanted = np.where(np.arange(ROWS) < 400, 0.0, 5.0)
    log = _pressed(robot, np.where(np.arange(ROWS) < 700, 4.0, 8.0), wanted)
    values = _values(log, robot)
    assert values["force_rmse"] == pytest.approx(np.sqrt((300 * 1.0 + 300 * 9.0) / 600))
    assert _values(log, robot, slice(0, 700))["force_rmse"] == pytest.approx(1.0)
    assert _values(log, robot, slice(0, 400))["force_rmse"] is None  # none is wanted


def test_force_error_in_the_band_is_what_a_second_order_filter_of_5_Hz_leaves(robot: Robot) -> None:
    rows = 4000
    time = np.arange(rows) * PERIOD
    for hertz in (0.5, 5.0, 50.0):
        log = _pressed(robot, 5.0 + np.sin(2 * np.pi * hertz * time), np.full(rows, 5.0), rows)
        values = _values(log, robot, slice(2000, rows))
        assert values["force_rmse"] == pytest.approx(np.sqrt(0.5), rel=1e-3)
        left = 1 / np.sqrt(1 + (hertz / FORCE_BAND) ** 4)  # of an analogue Butterworth filter
        assert values["force_rmse_band"] == pytest.approx(left * np.sqrt(0.5), rel=0.03), hertz


def test_band_starts_at_rest(robot: Robot) -> None:
    np.testing.assert_allclose(in_band(np.full(100, 7.0), PERIOD), 7.0)


def test_airborne_is_counted_where_a_force_is_wanted(robot: Robot) -> None:
    row = np.arange(ROWS)
    log = _pressed(robot, np.where(row % 4 == 0, 0.0, 3.0) * (row >= 500), np.where(row < 500, 0.0, 3.0))
    assert _values(log, robot)["airborne"] == pytest.approx(0.25)


def test_a_force_that_never_was_has_no_error(robot: Robot) -> None:
    values = _values(_pressed(robot, np.zeros(ROWS), np.full(ROWS, 5.0)), robot)
    assert [values[n] for n in ("force_rmse", "force_rmse_band", "airborne", "peak_force")] == [None] * 4


def test_solve_times_and_statuses(robot: Robot) -> None:
    log = _log(robot)
    log.solve_times = np.arange(101) * 1e-6
    log.statuses = {"OK": 90, "MAX_ITERATIONS": 4, "DEADLINE": 1, "BAD_INPUT": 3, "INFEASIBLE": 2, "NUMERICAL": 1}
    log.wall = 0.25
    values = _values(log, robot)
    assert values["solve_p50"] == pytest.approx(50e-6)
    assert values["solve_p99"] == pytest.approx(99e-6)
    assert values["solve_max"] == pytest.approx(100e-6)
    assert values["stand_ins"] == 6
    assert values["real_time_factor"] == pytest.approx(4.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rows", [0, 10])
def test_run_that_ended_before_the_judged_window(robot: Robot, rows: int) -> None:
    log = _log(robot, rows=rows, f_contact_W=np.ones((rows, 3)))
    values = _values(log, robot, log.window(0.5, 1.0))
    assert values["tool_rmse"] is None
    assert values["airborne"] is None
    assert all(v is None or np.isfinite(v) for v in values.values())
