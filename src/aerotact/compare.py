"""Compare: every controller of an experiment on the same plant with the same seeds, as a table beside the paper."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from rich import box
from rich.table import Table

from aerotact.codegen.build import compile_library
from aerotact.dynamics.model_of import model_of
from aerotact.experiments import find_experiment
from aerotact.experiments.experiment import Case, Experiment
from aerotact.flight import (
    Options,
    Result,
    chain_projects,
    controller_project,
    estimator_names,
    find_controller,
    fly,
    robot_of,
    shown_name,
)
from aerotact.metrics import UNITS
from aerotact.robot import load_robot

Statistic = dict[str, float | str | None]


@dataclass(frozen=True)
class Comparison:
    """What a comparison found.

    Attributes:
        experiment: its name.
        seeds: that were flown.
        paper: metric -> number of the paper.
        controllers: label -> metric -> mean and std over the seeds, and the unit; mean is None where it does not apply.
            Runs that ended early do not count.
        results: of every run.
    """

    experiment: str
    seeds: tuple[int, ...]
    paper: dict[str, float]
    controllers: dict[str, dict[str, Statistic]]
    results: tuple[Result, ...]

    @property
    def faults(self) -> list[str]:
        """Runs that ended early, each with its reason."""
        return [f"{r.controller} {r.case} seed {r.seed}: {r.fault}" for r in self.results if r.fault]

    def to_json(self) -> str:
        """The printed numbers for machines."""
        content = {
            "experiment": self.experiment,
            "seeds": list(self.seeds),
            "paper": self.paper,
            "controllers": self.controllers,
            "faults": self.faults,
        }
        return json.dumps(content, indent=2) + "\n"


def run_comparison(
    experiment: Experiment,
    seeds: Sequence[int],
    options: Options,
    labels: Sequence[str] | None = None,
    cases: Sequence[str] | None = None,
    jobs: int = 2,
    progress: Callable[[int, int, str], None] | None = None,
) -> Comparison:
    """Fly every controller in every case with every seed.

    Args:
        experiment: what to fly.
        seeds: of the sensors.
        options: robot, state, delay, folder of the logs.
        labels: controllers; None is those of the experiment.
        cases: names; None is all.
        jobs: processes.
        progress: called with runs done, runs in all, and what comes next.

    Raises:
        AerotactError: a controller, a case or the robot does not fit.
    """
    labels = list(labels or experiment.controllers)
    chosen = [c for c in experiment.cases if cases is None or c.name in cases]
    tell = progress or (lambda done, total, what: None)
    total = len(labels) * len(chosen) * len(seeds)
    tell(0, total, "generating and compiling the controllers")
    _compile_all(experiment, labels, chosen, options)
    runs = [(label, case.name, seed) for seed in seeds for label in labels for case in chosen]
    tell(0, total, "flying")
    work = (delayed(_fly_one)(experiment.name, label, case, seed, options) for label, case, seed in runs)
    results: list[Result] = []
    for result in Parallel(n_jobs=min(jobs, len(runs)), return_as="generator")(work):
        results.append(result)
        tell(len(results), total, f"{result.controller} {result.case} seed {result.seed}")
    return Comparison(
        experiment.name,
        tuple(seeds),
        {name: number.value for name, number in experiment.paper.items()},
        {name: _statistics([r for r in results if r.controller == name]) for name in map(shown_name, labels)},
        tuple(results),
    )


def _compile_all(experiment: Experiment, labels: Sequence[str], cases: Sequence[Case], options: Options) -> None:
    """Fill the cache once, so that the processes only load."""
    for name in dict.fromkeys(robot_of(experiment, case, options) for case in cases):
        robot = load_robot(name)
        model = model_of(robot)
        for label in labels:
            for project in chain_projects(find_controller(experiment, label), model, options):
                compile_library(project)
        for estimator in estimator_names(robot):
            compile_library(controller_project(estimator, model, robot.file.sensors.imu.rate))


def _fly_one(experiment: str, label: str, case: str, seed: int, options: Options) -> Result:
    found = find_experiment(experiment)
    chosen = next(c for c in found.cases if c.name == case)
    return fly(found, chosen, label, seed, options)[1]


def _statistics(results: Sequence[Result]) -> dict[str, Statistic]:
    """Mean and standard deviation of each metric over the seeds, of each seed its mean over those runs that have it.

    A run that ended early is left out: its numbers are of another length.
    """
    whole = [r for r in results if not r.fault]
    statistics: dict[str, Statistic] = {}
    for name in dict.fromkeys(name for r in whole for name in r.metrics):
        found = [(r.seed, r.metrics[name]) for r in whole if name in r.metrics]
        seeds: dict[int, list[float]] = {}
        for seed, metric in found:
            if metric.value is not None:
                seeds.setdefault(seed, []).append(metric.value)
        values = np.array([np.mean(v) for v in seeds.values()])
        statistics[name] = {
            "mean": float(values.mean()) if values.size else None,
            "std": float(values.std()) if values.size else None,
            "unit": found[0][1].unit,
        }
    return statistics


_SCALES = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}
_COMPUTING = (1e6, "us")  # seconds of the metrics that every run has; an experiment's own stay in s


def comparison_rows(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table: the experiment's own metrics first, then those that every run has."""
    labels = list(comparison.controllers)
    names = dict.fromkeys(n for label in labels for n in comparison.controllers[label])
    own = [n for n in names if n not in UNITS]
    rows = []
    for name in [*own, *(n for n in names if n in UNITS)]:
        unit = next(str(s[name]["unit"]) for s in comparison.controllers.values() if name in s)
        scale, shown = _COMPUTING if unit == "s" and name in UNITS else _SCALES.get(unit, (1.0, unit))
        paper = comparison.paper.get(name)
        cells = [_cell(comparison.controllers[label].get(name), scale) for label in labels]
        if all(c == "-" for c in cells):
            continue
        first = name if shown == "1" else f"{name}, {shown}"
        rows.append([first, "-" if paper is None else _digits(paper * scale), *cells])
    return ["metric", "paper", *labels], rows


def _digits(value: float) -> str:
    """Four significant digits without an exponent for everyday sizes; 0 for what is nothing."""
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _cell(statistic: Statistic | None, scale: float) -> str:
    if statistic is None or statistic["mean"] is None:
        return "-"
    mean, std = float(statistic["mean"]) * scale, float(statistic["std"] or 0.0) * scale
    if std < 1e-4 * abs(mean) or std == 0.0:
        return _digits(mean)
    # Both to the place of the deviation's second digit or of the mean's fifth.
    places = 1 - int(np.floor(np.log10(std)))
    if mean != 0.0:
        places = min(places, 4 - int(np.floor(np.log10(abs(mean)))))
    places = max(0, places)
    return f"{mean:.{places}f} ± {std:.{places}f}" if places < 6 else _digits(mean)


def comparison_table(comparison: Comparison) -> Table:
    """The table for a terminal; where it is narrow, cells are wrapped and nothing is cut off."""
    header, rows = comparison_rows(comparison)
    seeds = len(comparison.seeds)
    spread = f"mean ± std over {seeds} seeds" if seeds > 1 else "one seed"
    early = len(comparison.faults)
    caption = f"{early} of {len(comparison.results)} runs ended early and are not in the means" if early else None
    title = f"{comparison.experiment}, {spread}"
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True)
    for i, name in enumerate(header):
        table.add_column(name, justify="left" if i == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def first_seed_logs(comparison: Comparison) -> dict[tuple[str, str], Path]:
    """(controller, case) -> log file of the first seed, for plots; without runs that ended early."""
    found = [r for r in comparison.results if r.seed == comparison.seeds[0] and not r.fault]
    return {(r.controller, r.case): r.file for r in found if r.file is not None}
