"""Bench: the whole benchmark of one problem: record, race, growth, small blocks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from aerotact.bench.blocks import time_blocks
from aerotact.bench.machine import describe_machine
from aerotact.bench.peers.acados_peer import AcadosPeer, Setting
from aerotact.bench.problems import Problem, make_problem
from aerotact.bench.run import Progress, Race, Record, make_peers, qualify, race
from aerotact.bench.scenario import record
from aerotact.bench.summary import equal_work, growth_of, summarise
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
        blocks: robots whose laws and estimators are timed.
    """

    ocp: str
    samples: int = 600
    passes: int = 5
    horizons: Sequence[int] = ()
    only: Sequence[str] | None = None
    seed: int = SEED
    blocks: Sequence[str] = ()


def run_bench(options: Options, progress: Progress = lambda done, total, what: None) -> tuple[Race, dict[str, Any]]:
    """Race and summary."""
    machine = describe_machine()
    problem = make_problem(options.ocp)
    result = _race(problem, options.samples, options, options.only, progress)
    growth = _growth(options, result, progress)
    blocks: dict[str, Any] = {}
    for done, name in enumerate(options.blocks):
        progress(done, len(options.blocks), f"laws and estimators of {name}")
        robot = load_robot(name)
        blocks[robot.name] = time_blocks(model_of(robot))
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
    """Medians over the horizon for the generated solver and acados: of the whole, of preparation, whose work does not
    depend on which bounds are active, and of the samples that took the number of factorisations that is commonest."""
    steps = sorted(set(options.horizons))
    if not steps:
        return {}
    only = [k for k in ("aerotact", "acados") if options.only is None or k in options.only]
    found: dict[str, list[Record]] = {}
    for n in steps:
        count = min(options.samples, GROWTH_SAMPLES)
        result = _race(make_problem(options.ocp, n), count, options, only, progress, _scaled(first, n))
        for name, entry in (("aerotact", result.records.get("aerotact")), ("acados", result.best_acados)):
            if entry is not None:
                found.setdefault(name, []).append(entry)
    rows: dict[str, Any] = {}
    for name, records in found.items():
        rows[name] = growth_of(steps, [r.quiet for r in records])
        rows[f"{name}, preparation"] = growth_of(steps, [r.quiet_of(r.prepare) for r in records])
        work, times = equal_work(records)
        if work is not None:
            rows[f"{name}, {work} factorisation{'s' if work > 1 else ''}"] = growth_of(steps, times)
    return {"steps": steps, "samples": min(options.samples, GROWTH_SAMPLES), "solvers": rows}


def _scaled(first: Race, steps: int) -> list[Setting] | None:
    """acados' best setting, its number of blocks scaled with the horizon."""
    best = first.best_acados
    if best is None or not isinstance(best.peer, AcadosPeer):
        return None
    setting = best.peer.setting
    blocks = max(round(setting.condensed * steps / first.problem.transcription.steps), 1)
    return [replace(setting, condensed=blocks)]
