"""The page and the numbers, from times that are made up."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from aerotact.bench.blocks import time_blocks
from aerotact.bench.machine import describe_machine
from aerotact.bench.peers.acados_peer import AcadosPeer
from aerotact.bench.peers.peer import Answer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Solution
from aerotact.bench.report import page, plot
from aerotact.bench.run import Race, make_peers, race
from aerotact.bench.scenario import Sample
from aerotact.bench.summary import equal_work, exponent, growth_of, percentiles, summarise
from aerotact.cli import app
from aerotact.dynamics.model_of import model_of
from aerotact.robot import load_robot


class Fake:
    """A peer that knows the answer, or nearly, and takes as long as it is told."""

    settings, versions, build_seconds = "made up", {"fake": "1"}, 2.0

    def __init__(self, name: str, time: Callable[[int], float], error: float = 0.0, every: int = 1) -> None:
        self.name, self._time, self._error, self.every = name, time, error, every
        self.sizes = {"workspace": 2048, "code": 1024}
        self.resets = self._count = 0

    def reset(self) -> None:
        self.resets += 1
        self._count = 0

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        total = self._time(self._count)
        self._count += 1
        right = sample.reference.solution
        u = right.u + self._error
        return Answer(
            sample.first_control(u),
            total / 4,
            3 * total / 4,
            total,
            True,
            Solution(right.x, u, right.y),
            parts={"a": 1.0},
        )


@pytest.fixture
def made_up(problem: Problem, samples: list[Sample]) -> Race:
    peers = [
        Fake("aerotact", lambda i: 10.0 + i),
        Fake("acados quaternion/6", lambda _: 300.0, error=1e-3),
        Fake("acados tangent/3", lambda _: 200.0, error=1e-3),
        Fake("osqp 1e-3", lambda _: 20000.0, error=0.5, every=10),
    ]
    result = race(problem, samples, peers, passes=2, skipped=["ipopt: skipped"])
    assert [peer.resets for peer in peers] == [3, 3, 3, 2]  # two passes, the slow one once, and the accuracy
    return result


def test_the_numbers_have_the_names_that_are_promised(made_up: Race) -> None:
    growth = {"steps": [10, 20], "solvers": {"aerotact": {"p50_us": [1.0, 2.0], "samples": [9, 9], "exponent": 1.0}}}
    summary = json.loads(json.dumps(summarise(made_up, describe_machine(), growth)))
    assert {"machine", "ocp", "solvers"} <= summary.keys()
    assert {"cpu", "cores", "compiler", "versions"} <= summary["machine"].keys()
    assert set(summary["solvers"]) == {"aerotact", "acados", "acados quaternion/6", "osqp 1e-3"}
    for solver in summary["solvers"].values():
        assert {"p50_us", "p99_us", "max_us", "error_u0"} <= solver.keys()
        assert solver["error_u0"].keys() == {"median", "p99", "max"}
    ours = summary["solvers"]["aerotact"]
    assert ours["p50_us"] == pytest.approx(10 + (len(made_up.samples) - 1) / 2)
    assert ours["feedback"]["p50_us"] == pytest.approx(0.75 * ours["p50_us"])
    assert ours["error_u0"]["max"] == 0.0
    assert ours["residuals"]["feasibility"]["max"] < 1e-9
    assert summary["ratio_to_acados"]["p50"] == pytest.approx(200 / ours["p50_us"])
    assert summary["solvers"]["acados"]["error_u0"]["max"] is not None or not made_up.records
    assert summary["solvers"]["osqp 1e-3"]["deadline_misses"] == 3
    assert summary["solvers"]["osqp 1e-3"]["samples"] == 3
    phases = ours["phases"]
    assert phases["saturated"]["samples"] + phases["unsaturated"]["samples"] == len(made_up.samples)


def test_the_page_says_where_how_and_what(made_up: Race, tmp_path: Path) -> None:
    growth = {"steps": [10, 20], "solvers": {"aerotact": {"p50_us": [1.0, 2.0], "samples": [9, 9], "exponent": 1.0}}}
    summary = summarise(made_up, describe_machine(), growth)
    figures = plot(made_up, summary, tmp_path)
    assert all(f.stat().st_size > 1000 for f in figures)
    text = page(summary, figures)
    for expected in (
        summary["machine"]["cpu"],
        summary["machine"]["compiler"],
        "raw",
        "Growth",
        "ipopt: skipped",
        "| aerotact |",
    ):
        assert expected in text


def test_the_smallest_undisturbed_time_counts(made_up: Race) -> None:
    record = made_up.records["aerotact"]
    record.total = np.array([[5.0, 9.0], [7.0, 4.0]])
    record.interrupted = np.array([[True, False], [False, False]])
    assert record.quiet.tolist() == [7.0, 4.0]
    record.interrupted[:] = True
    assert record.quiet.tolist() == [5.0, 4.0]
    assert record.disturbed == 1.0


def test_growth_at_equal_work_compares_samples_that_are_alike(made_up: Race) -> None:
    found = [replace(made_up.records["aerotact"]) for _ in range(2)]
    for scale, record in zip((1.0, 2.0), found, strict=True):
        count = record.total.shape[1]
        record.total = np.tile(scale * np.arange(count, dtype=float), (2, 1))
        record.work = np.tile(np.where(np.arange(count) < 4, scale, 3.0), (2, 1))
        record.interrupted[:] = False
    work, times = equal_work(found)
    assert work == 3  # one occurs at the first horizon only, two at the second
    assert times[0].tolist() == list(range(4, count))
    growth = growth_of([10, 20], times)
    assert growth["samples"] == [count - 4] * 2
    assert growth["exponent"] == pytest.approx(1.0)
    found[1].work[:] = np.nan
    assert equal_work(found) == (None, [])


def test_exponents_and_percentiles() -> None:
    assert exponent([10, 20, 40], [3.0, 6.0, 12.0]) == pytest.approx(1.0)
    assert exponent([10], [1.0]) is None
    assert percentiles(np.zeros(0)) == {"p50": None, "p99": None, "max": None}


def test_without_acados_the_others_race(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ACADOS_SOURCE_DIR", raising=False)
    peers, skipped = make_peers(problem, ["acados", "casadi"])
    assert skipped == ["acados: skipped, ACADOS_SOURCE_DIR is not set"]
    assert peers
    assert not any(isinstance(p, AcadosPeer) for p in peers)


def test_without_hpipm_the_others_race(problem: Problem, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HPIPM_DIR", str(tmp_path))
    peers, skipped = make_peers(problem, ["hpipm", "aerotact"])
    assert [p.name for p in peers] == ["aerotact"]
    assert len(skipped) == 1
    assert skipped[0].startswith("hpipm: skipped, the library hpipm was not found")


@pytest.mark.parametrize(
    ("robot", "observer"),
    [
        ("tilt_hex", "momentum_observer"),
        ("tilt_rotor", "momentum_observer"),
        ("dual_arm_standard", "multibody_observer"),
    ],
)
def test_laws_and_estimators_take_microseconds(robot: str, observer: str) -> None:
    blocks = time_blocks(model_of(load_robot(robot)))
    assert {"state_estimator", observer} <= blocks.keys()
    for block in blocks.values():
        assert block["usable"]
        assert 0 < block["p50_us"] < 1000
        assert block["bytes"]["workspace"] > 0


def test_the_command_writes_page_and_numbers(tmp_path: Path) -> None:
    arguments = ["bench", "--samples", "20", "--passes", "1", "-s", "aerotact", "-o", str(tmp_path)]
    done = CliRunner().invoke(app, [*arguments, "--json", str(tmp_path / "numbers.json")])
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "numbers.json").read_text())
    assert summary["ocp"] == "H"
    assert summary["solvers"]["aerotact"]["error_u0"]["max"] < 2e-3
    assert (tmp_path / "H.md").read_text().startswith("# Benchmark H")
    assert (tmp_path / "H.png").is_file()
