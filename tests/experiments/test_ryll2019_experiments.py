"""ryll2019's experiments: ideal and metrics are right; both controllers keep the bands on estimated state."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.experiments import find_experiment
from aerotact.experiments.experiment import Case
from aerotact.experiments.ryll2019 import (
    CALIBRATE,
    DEAD_ZONE,
    END,
    PULL,
    PULL_START,
    PULL_STOP,
    FreeFlight,
    PropertyShaping,
    ideal_response,
)
from aerotact.flight import Options, Result, fly
from aerotact.log import Log
from aerotact.ports import Array
from aerotact.robot import load_robot

OCTOROTOR = str(Path(__file__).parents[1] / "fixtures" / "octorotor")
SHAPING, TOUR = PropertyShaping(), FreeFlight()
CASES = {case.name: case for case in SHAPING.cases}
STEADY_BAND, REFERENCE_BAND, TRACKING_BAND = 5e-3, 20e-3, 20e-3  # m
TIME = np.arange(32000) * 1e-3


@cache
def _flown(experiment: str, case_name: str, label: str, seed: int = 0, robot: str | None = None) -> Result:
    found = find_experiment(experiment)
    case = next(c for c in found.cases if c.name == case_name)
    return fly(found, case, label, seed, Options(robot))[1]


def _metrics(result: Result) -> dict[str, float]:
    assert result.fault == ""
    return {name: metric.value for name, metric in result.metrics.items() if metric.value is not None}


def _within_limits(metrics: dict[str, float]) -> bool:
    return metrics["violations_thrust"] == 0 and metrics["violations_thrust_rate"] == 0


# the ideal


@pytest.mark.parametrize("name", CASES)
def test_ideal_response_solves_the_mass_spring_damper(name: str) -> None:
    M, D, K = (float(np.mean(CASES[name].parameters[p])) for p in ("M_EP", "D_EP", "K_EP"))

    def slope(_: float, state: Array, force: float) -> Array:
        return np.array([state[1], (force - D * state[1] - K * state[0]) / M])

    state, kept = np.zeros(2), []
    for start, stop, force in ((0, PULL_START, 0.0), (PULL_START, PULL_STOP, PULL - DEAD_ZONE), (PULL_STOP, END, 0.0)):
        times = TIME[round(1e3 * start) : round(1e3 * stop)]
        solved = solve_ivp(slope, (start, stop), state, t_eval=times, args=(force,), rtol=1e-10, atol=1e-12)
        ended = solve_ivp(slope, (start, stop), state, args=(force,), rtol=1e-10, atol=1e-12)
        kept.append(solved.y)
        state = ended.y[:, -1]
    x, v = ideal_response(TIME, M, D, K)
    np.testing.assert_allclose([x, v], np.hstack(kept), atol=1e-8)
    assert x[19999] == pytest.approx((PULL - DEAD_ZONE) / K, rel=0.02)


def test_ideal_response_does_not_depend_on_the_samples() -> None:
    for fine, coarse in zip(
        ideal_response(TIME, 1.5, 5.0, 6.0), ideal_response(TIME[::10], 1.5, 5.0, 6.0), strict=True
    ):
        np.testing.assert_allclose(fine[::10], coarse, atol=1e-10)


# metrics and plots of logs made by hand


def _ideal_log(case: Case, tool_ahead: float, reference_ahead: float) -> Log:
    """The tool and its reference on the ideal from x = 0.4 m, each ahead of it by so many m from the pull on."""
    M, D, K = (float(np.mean(case.parameters[p])) for p in ("M_EP", "D_EP", "K_EP"))
    x, v = ideal_response(TIME, M, D, K)
    pulled = TIME >= PULL_START
    zero = np.zeros((len(TIME), 3))
    columns = {"time": TIME[:, None]} | {
        name: zero.copy() for name in ("p_WE", "p_WE_r", "v_WE", "v_WE_r", "f_tool_W_est")
    }
    columns["p_WE"][:, 0] = 0.4 + x + tool_ahead * pulled
    columns["p_WE_r"][:, 0] = 0.4 + x + reference_ahead * pulled
    columns["v_WE"][:, 0] = columns["v_WE_r"][:, 0] = v
    return Log(1e-3, columns, {}, {}, every=10)


def test_property_shaping_metrics() -> None:
    case = CASES["K8"]
    log = _ideal_log(case, tool_ahead=0.004, reference_ahead=-0.007)
    # What a slow controller still says between its steps does not count.
    log.columns["p_WE_r"][20005, 0] = 9.0
    metrics = {name: metric.value for name, metric in SHAPING.metrics(case, log).items()}
    assert metrics["expected_K8"] == pytest.approx((0.14 * 9.81 - 0.2) / 8)
    assert metrics["steady_K8"] == pytest.approx(metrics["expected_K8"] + 0.004, abs=1e-5)
    assert metrics["reference_gap_K8"] == pytest.approx(0.007)
    assert metrics["ideal_rmse_K8"] == metrics["ideal_rmse"] == pytest.approx(0.004)
    assert {m.unit for m in SHAPING.metrics(case, log).values()} == {"m"}


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.05, 2.0])
def test_free_flight_metrics(angle: float) -> None:
    case, rng = TOUR.cases[0], np.random.default_rng(2)
    time = np.arange(21000) * 1e-3
    wanted = Rotation.random(len(time), rng=rng)
    judged = (time >= case.judged[0])[:, None]
    turned = wanted * Rotation.from_rotvec(angle * judged * np.array([0.6, 0.0, 0.8]))
    sign = rng.choice([-1.0, 1.0], size=(len(time), 1))
    p = rng.normal(size=(len(time), 3))
    columns = {
        "time": time[:, None],
        "p_WE_d": p,
        "p_WE": p + np.where(judged, [0.003, 0.0, 0.004], [1.0, 0.0, 0.0]),
        "q_WE_d": wanted.as_quat(scalar_first=True),
        "q_WE": sign * turned.as_quat(scalar_first=True),
    }
    metrics = {name: m.value for name, m in TOUR.metrics(case, Log(1e-3, columns, {}, {})).items()}
    assert metrics["position_error_max"] == pytest.approx(0.005)
    assert metrics["position_error_rmse"] == pytest.approx(0.005)
    assert metrics["attitude_error_max"] == pytest.approx(angle, abs=1e-9)
    assert metrics["attitude_error_rmse"] == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize("names", [["D5"], ["K4", "M3"], list(CASES)])
def test_property_shaping_plots_what_there_is(names: list[str], tmp_path: Path) -> None:
    logs = {("law", name): _ideal_log(CASES[name], 0.004, 0.0).columns for name in names}
    files = SHAPING.plot(logs, tmp_path / "new")
    assert [f.name for f in files] == ["fig7_law.png", "distance_to_ideal.png"]
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)


def test_tour_stays_slow_and_nearly_level_wherever_the_tool_points() -> None:
    for robot in ("tilt_hex", OCTOROTOR):
        model = Model(load_robot(robot))
        sample = TOUR.reference(TOUR.cases[0], model).sample(TIME[:21000])
        assert 0.2 < np.linalg.norm(sample["v_WE_d"], axis=1).max() < 0.5
        R_WE = Rotation.from_quat(sample["q_WE_d"], scalar_first=True).as_matrix()
        tilt = np.arccos(np.clip((R_WE @ model.robot.R_BE.T)[:, 2, 2], -1, 1))
        assert np.deg2rad(9) < tilt.max() < np.deg2rad(13)


def test_observer_calibrates_before_the_pull() -> None:
    assert 0 < CALIBRATE[0] < CALIBRATE[1] < PULL_START


# the controllers, on the state estimated from simulated sensors


@pytest.mark.parametrize("name", CASES)
def test_property_shaping_by_law_and_mpc(name: str) -> None:
    law, mpc = (_metrics(_flown(SHAPING.name, name, label)) for label in ("law", "mpc"))
    assert mpc[f"ideal_rmse_{name}"] < law[f"ideal_rmse_{name}"]
    assert mpc["tool_rmse"] < law["tool_rmse"]
    assert _within_limits(mpc)
    assert mpc["stand_ins"] == 0
    for metrics in (law, mpc):
        assert metrics[f"steady_{name}"] == pytest.approx(metrics[f"expected_{name}"], abs=STEADY_BAND)
        assert metrics[f"reference_gap_{name}"] < REFERENCE_BAND


@pytest.mark.parametrize("name", ["K4", "K6", "K8"])
def test_property_shaping_by_the_tuned_law(name: str) -> None:
    metrics = _metrics(_flown(SHAPING.name, name, "law-tuned"))
    assert metrics[f"steady_{name}"] == pytest.approx(metrics[f"expected_{name}"], abs=STEADY_BAND)
    assert metrics[f"reference_gap_{name}"] < REFERENCE_BAND


def test_nominal_case_with_other_noise() -> None:
    law, mpc = (_metrics(_flown(SHAPING.name, "K6", label, seed=1)) for label in ("law", "mpc"))
    assert mpc["ideal_rmse"] < law["ideal_rmse"]
    for metrics in (law, mpc):
        assert metrics["steady_K6"] == pytest.approx(metrics["expected_K6"], abs=STEADY_BAND)
        assert metrics["reference_gap_K6"] < REFERENCE_BAND


@pytest.mark.parametrize("label", ["law", "mpc"])
@pytest.mark.parametrize("robot", [None, OCTOROTOR], ids=["tilt_hex", "octorotor"])
def test_free_flight_is_tracked(robot: str | None, label: str) -> None:
    metrics = _metrics(_flown(TOUR.name, "tour", label, robot=robot))
    assert metrics["position_error_max"] < TRACKING_BAND
    assert _within_limits(metrics)
    assert metrics["stand_ins"] == 0


@pytest.mark.parametrize("label", ["law", "mpc"])
def test_octorotor_shapes_its_stiffness(label: str) -> None:
    metrics = _metrics(_flown(SHAPING.name, "K6", label, robot=OCTOROTOR))
    assert metrics["steady_K6"] == pytest.approx(metrics["expected_K6"], abs=STEADY_BAND)
    assert metrics["reference_gap_K6"] < REFERENCE_BAND
    assert _within_limits(metrics)
    assert metrics["stand_ins"] == 0
