"""Comparisons: numbers over seeds and cases, the JSON for machines, the table of 80 columns, runs that end early."""

import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from aerotact import compare
from aerotact.compare import Comparison, comparison_rows, comparison_table, first_seed_logs, run_comparison
from aerotact.exceptions import UnknownName
from aerotact.experiments import find_experiment
from aerotact.experiments.experiment import Case, Experiment
from aerotact.flight import Options, Result
from aerotact.metrics import UNITS, Metric

SHAPING = "ryll2019/property-shaping"
STANDARD = (
    "force_rmse",
    "force_rmse_band",
    "tool_rmse",
    "peak_force",
    "airborne",
    "violations_thrust",
    "violations_thrust_rate",
    "violations_tilt",
    "violations_tilt_rate",
    "real_time_factor",
)


def _result(label: str, case: str, seed: int, fault: str = "", **values: float | None) -> Result:
    """A run whose standard metrics are None or 0 but for those given; `steady_...` and `ideal...` are in m."""
    standard = {name: Metric(0.0 if "violations" in name else None, unit) for name, unit in UNITS.items()}
    given = {name: Metric(value, UNITS.get(name, "m")) for name, value in values.items()}
    return Result(label, case, seed, standard | given, fault, Path(f"{label}/{case}/seed{seed}.parquet"))


def _compare(monkeypatch: pytest.MonkeyPatch, results: list[Result], labels: list[str]) -> Comparison:
    """The comparison that these runs make, instead of flights."""
    runs = {(r.controller, r.case, r.seed): r for r in results}

    def fly(experiment: Experiment, case: Case, label: str, seed: int, options: Options) -> tuple[None, Result]:
        return None, runs[label, case.name, seed]

    monkeypatch.setattr(compare, "fly", fly)
    monkeypatch.setattr(compare, "_compile_all", lambda *_: None)
    seeds, cases = sorted({r.seed for r in results}), list({r.case: None for r in results})
    return run_comparison(find_experiment(SHAPING), seeds, Options(), labels, cases, jobs=1)


def _mean_and_std(comparison: Comparison, label: str, metric: str) -> tuple[object, object]:
    statistic = comparison.controllers[label][metric]
    return statistic["mean"], statistic["std"]


def test_statistics_are_over_seeds_of_means_over_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    results = [
        _result("law", "K4", 0, tool_rmse=1.0, steady_K4=0.29),
        _result("law", "K6", 0, tool_rmse=3.0, steady_K6=0.19, peak_force=7.0),
        _result("law", "K4", 1, tool_rmse=5.0, steady_K4=0.31),
        _result("law", "K6", 1, tool_rmse=7.0, steady_K6=0.21),
    ]
    comparison = _compare(monkeypatch, results, ["law"])
    assert _mean_and_std(comparison, "law", "tool_rmse") == (4.0, 2.0)
    assert _mean_and_std(comparison, "law", "steady_K4") == pytest.approx((0.30, 0.01))
    assert _mean_and_std(comparison, "law", "steady_K6") == pytest.approx((0.20, 0.01))
    assert _mean_and_std(comparison, "law", "peak_force") == (7.0, 0.0)
    assert _mean_and_std(comparison, "law", "airborne") == (None, None)


def test_json_has_the_documented_form(monkeypatch: pytest.MonkeyPatch) -> None:
    results = [_result(label, "K6", 0, tool_rmse=0.002, steady_K6=0.195) for label in ("law", "law-tuned", "mpc")]
    content = json.loads(_compare(monkeypatch, results, ["law", "law-tuned", "mpc"]).to_json())
    assert set(content) == {"experiment", "seeds", "paper", "controllers", "faults"}
    assert content["experiment"] == SHAPING
    assert content["seeds"] == [0]
    assert content["faults"] == []
    assert content["paper"]["steady_K6"] == 0.19
    assert list(content["controllers"]) == ["law", "law-tuned", "mpc"]
    for metrics in content["controllers"].values():
        assert set(STANDARD) | {"steady_K6"} <= set(metrics)
        assert all(set(m) == {"mean", "std", "unit"} for m in metrics.values())
        assert metrics["tool_rmse"] == {"mean": 0.002, "std": 0.0, "unit": "m"}
        assert metrics["force_rmse"] == {"mean": None, "std": None, "unit": "N"}


def test_run_that_ended_early_is_told_and_not_averaged(monkeypatch: pytest.MonkeyPatch) -> None:
    results = [
        _result("law", "K6", 0, tool_rmse=1.0),
        _result("law", "K6", 1, fault="plant stopped at 3 s", tool_rmse=100.0),
        _result("mpc", "K6", 0, fault="plant stopped at 4 s", tool_rmse=100.0),
        _result("mpc", "K6", 1, fault="plant stopped at 5 s", tool_rmse=100.0),
    ]
    comparison = _compare(monkeypatch, results, ["law", "mpc"])
    assert comparison.faults == [
        "mpc K6 seed 0: plant stopped at 4 s",
        "law K6 seed 1: plant stopped at 3 s",
        "mpc K6 seed 1: plant stopped at 5 s",
    ]
    assert _mean_and_std(comparison, "law", "tool_rmse") == (1.0, 0.0)
    assert comparison.controllers["mpc"] == {}
    assert list(first_seed_logs(comparison)) == [("law", "K6")]
    assert "3 of 4 runs ended early" in _printed(comparison)
    assert json.loads(comparison.to_json())["faults"] == comparison.faults


def test_progress_counts_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "fly", lambda e, c, label, seed, o: (None, _result(label, c.name, seed)))
    monkeypatch.setattr(compare, "_compile_all", lambda *_: None)
    told: list[tuple[int, int]] = []
    run_comparison(
        find_experiment(SHAPING),
        [0, 1],
        Options(),
        ["law"],
        ["K4"],
        1,
        lambda done, total, _: told.append((done, total)),
    )
    assert told == [(0, 2), (0, 2), (1, 2), (2, 2)]


def test_unknown_controller_is_named_before_anything_flies() -> None:
    with pytest.raises(UnknownName, match=r"unknown controller 'pid' in ryll2019/property-shaping; valid: .*law-tuned"):
        run_comparison(find_experiment(SHAPING), [0], Options(), ["law", "pid"], ["K4"], 1)


def _comparison(controllers: Mapping[str, Mapping[str, tuple[float | None, float, str]]]) -> Comparison:
    statistics = {
        label: {
            name: {"mean": mean, "std": None if mean is None else std, "unit": unit}
            for name, (mean, std, unit) in metrics.items()
        }
        for label, metrics in controllers.items()
    }
    return Comparison(SHAPING, (0, 1), {"steady_K4": 0.29}, statistics, ())


def _printed(comparison: Comparison) -> str:
    text = io.StringIO()
    Console(file=text, width=80).print(comparison_table(comparison))
    return text.getvalue()


@pytest.mark.parametrize(
    ("metric", "cells"),
    [
        (("steady_K4", (0.293412, 0.00052, "m")), ["steady_K4, mm", "290", "293.41 ± 0.52"]),
        (("steady_K6", (0.196123, 0.000052, "m")), ["steady_K6, mm", "-", "196.12 ± 0.05"]),
        (("ideal_rmse", (0.0029, 0.0, "m")), ["ideal_rmse, mm", "-", "2.9"]),
        (("attitude_error_max", (np.pi / 180, 0.01, "rad")), ["attitude_error_max, deg", "-", "1.00 ± 0.57"]),
        (("solve_p50", (261.8e-6, 12e-6, "s")), ["solve_p50, us", "-", "262 ± 12"]),
        (("solve_max", (0.039571, 0.0, "s")), ["solve_max, us", "-", "39571"]),
        (("effort", (1238.1, 130.0, "N^1.5 s")), ["effort, N^1.5 s", "-", "1238 ± 130"]),
        (("violations_thrust", (0.0, 0.0, "1")), ["violations_thrust", "-", "0"]),
        (("real_time_factor", (6.245, 1e-5, "1")), ["real_time_factor", "-", "6.245"]),
    ],
)
def test_cells(metric: tuple[str, tuple[float, float, str]], cells: list[str]) -> None:
    header, rows = comparison_rows(_comparison({"law": dict([metric])}))
    assert header == ["metric", "paper", "law"]
    assert rows == [cells]


def test_rows_put_the_experiments_own_metrics_first_and_leave_out_what_nobody_has() -> None:
    law = {"tool_rmse": (0.001, 0.0, "m"), "airborne": (None, 0.0, "1"), "steady_K4": (0.29, 0.0, "m")}
    _, rows = comparison_rows(_comparison({"law": law, "mpc": {"own": (1.0, 0.0, "1")}}))
    assert [(row[0], row[2], row[3]) for row in rows] == [
        ("steady_K4, mm", "290", "-"),
        ("own", "-", "1"),
        ("tool_rmse, mm", "1", "-"),
    ]


def test_table_fits_80_columns() -> None:
    metrics = {
        "reference_gap_M0.75": (0.0112345, 0.00123, "m"),
        "violations_thrust_rate": (123.4, 12.3, "1"),
        "solve_max": (0.0208412, 0.0053, "s"),
        "steady_K4": (0.293412, 0.000052, "m"),
        "effort": (2123.4, 1.2, "N^1.5 s"),
        "real_time_factor": (10.53, 1.25, "1"),
    }
    lines = _printed(_comparison(dict.fromkeys(("law", "law-tuned", "mpc"), metrics))).splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)
    for cell in ("293.41 ± 0.05", "2123.4 ± 1.2", "20841 ± 5300"):
        assert sum(line.count(cell) for line in lines) == 3
