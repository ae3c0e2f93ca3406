"""Bench: the whole benchmark of one problem: record, race, growth, small blocks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerotact.bench.blocks import time_blocks
from aerotact.bench.machine import describe_machine
from aerotact.bench.peers.acados_peer import AcadosPeer, Setting
from aerotact.bench.problems import Problem, make_problem
from aerotact.bench.run import Progress, Race, make_peers, qualify, race
from aerotact.bench.scenario import record
from aerotact.bench.summary import exponent, summarise
from aerotact.dynamics.model_of import model_of
from aerotact.robot import load_robot

GROWTH_SAMPLES = 150
SEED = 11


@dataclass(frozen=True)
class Options:
    """What to do.

    Attributes:
        ocp: "H", "O" or an ocp file.
        samples, passes: recorded samples; timed passes over them.
        horizons: further numbers of intervals for the growth; none if empty.
        only: kinds of peers; all if None.
        seed: of the steps of the reference.
        blocks: robot whose laws and estimators are timed; none if None.
    """

    ocp: str
    samples: int = 600
    passes: int = 5
    horizons: Sequence[int] = ()
    only: Sequence[str] | None = None
    seed: int = SEED
    blocks: str | None = None


def run_bench(options: Options, progress: Progress = lambda done, total, what: None) -> tuple[Race, dict[str, Any]]:
    """Race and summary."""
    machine = describe_machine()
    problem = make_problem(options.ocp)
    result = _race(problem, options.samples, options, options.only, progress)
    growth = _growth(options, result, progress)
    blocks: dict[str, Any] = {}
    if options.blocks is not None:
        progress(0, 1, "laws and estimators")
        blocks = time_blocks(model_of(load_robot(options.blocks)))
    return result, summarise(result, machine, growth, blocks)


def _race(
    problem: Problem,
    count: int,
    options: Options,
    only: Sequence[str] | None,
    progress: Progress,
    acados: Sequence[Setting] | None = None,
) -> Race:
    progress(0, 1, "building")
    peers, skipped = make_peers(problem, only, acados)
    samples = record(problem, count, options.seed, lambda done: progress(done, count, "recording"))
    peers, times = qualify(samples, peers, progress)
    return race(problem, samples, peers, options.passes, skipped, times, progress)


def _growth(options: Options, first: Race, progress: Progress) -> dict[str, Any]:
    """Medians over the horizon for the generated solver and acados: of the whole, and of preparation, whose work does
    not depend on which bounds are active."""
    steps = sorted(set(options.horizons))
    if not steps:
        return {}
    only = [k for k in ("aerotact", "acados") if options.only is None or k in options.only]
    medians: dict[str, list[float]] = {}
    for n in steps:
        count = min(options.samples, GROWTH_SAMPLES)
        result = _race(make_problem(options.ocp, n), count, options, only, progress, _scaled(first, n))
        best = result.best_acados
        for name, found in (("aerotact", result.records.get("aerotact")), ("acados", best)):
            if found is not None:
                medians.setdefault(name, []).append(float(np.median(found.quiet)))
                prepare = float(np.median(found.quiet_of(found.prepare)))
                medians.setdefault(f"{name}, preparation", []).append(prepare)
    return {
        "steps": steps,
        "samples": min(options.samples, GROWTH_SAMPLES),
        "solvers": {name: {"p50_us": v, "exponent": exponent(steps, v)} for name, v in medians.items()},
    }


def _scaled(first: Race, steps: int) -> list[Setting] | None:
    """acados' best setting, its number of blocks scaled with the horizon."""
    best = first.best_acados
    if best is None or not isinstance(best.peer, AcadosPeer):
        return None
    setting = best.peer.setting
    blocks = max(round(setting.condensed * steps / first.problem.transcription.steps), 1)
    return [replace(setting, condensed=blocks)]
