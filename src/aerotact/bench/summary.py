"""Summary: a race, growth with the horizon and the small blocks as one dictionary, ready for JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aerotact.bench.run import Race, Record
from aerotact.ports import Array

ALIKE = 0.1
"""Share of the samples that must have taken the same number of factorisations."""


def percentiles(values: Array) -> dict[str, float | None]:
    """p50, p99, max; None where nothing was measured."""
    good = values[np.isfinite(values)]
    if not good.size:
        return {"p50": None, "p99": None, "max": None}
    return {"p50": float(np.percentile(good, 50)), "p99": float(np.percentile(good, 99)), "max": float(good.max())}


def _microseconds(values: Array) -> dict[str, float | None]:
    return {f"{key}_us": value for key, value in percentiles(values).items()}


def solver_summary(race: Race, record: Record) -> dict[str, Any]:
    """Numbers of one peer."""
    saturated = np.array([race.samples[int(i)].saturated for i in record.index])
    contact = np.array([race.samples[int(i)].contact for i in record.index])
    phases = {"unsaturated": ~saturated, "saturated": saturated, "contact": contact}
    error, columns = percentiles(record.error), ("stationarity", "feasibility", "complementarity")
    return {
        **_microseconds(record.quiet),
        "raw": _microseconds(record.total.ravel()),
        "prepare": _microseconds(record.quiet_of(record.prepare)),
        "feedback": _microseconds(record.quiet_of(record.feedback)),
        "parts": {name: _microseconds(record.quiet_of(values)) for name, values in record.parts.items()},
        "phases": {
            name: {"samples": int(mask.sum()), **_microseconds(record.quiet[mask])} for name, mask in phases.items()
        },
        "error_u0": {"median": error["p50"], "p99": error["p99"], "max": error["max"]},
        "error_u0_unsaturated": percentiles(record.error[~saturated])
        if record.error.size
        else percentiles(record.error),
        "residuals": {name: percentiles(record.residuals[:, i]) for i, name in enumerate(columns)},
        "one_iteration_leaves": percentiles(record.remaining),
        "usable": record.usable,
        "disturbed": record.disturbed,
        "deadline_misses": int((record.total > 1e6 / race.problem.rate).sum()),
        "solves": int(record.total.size),
        "samples": int(record.index.size),
        "build_seconds": record.peer.build_seconds,
        "bytes": dict(record.peer.sizes),
        "settings": record.peer.settings,
    }


def summarise(
    race: Race,
    machine: Mapping[str, Any],
    growth: Mapping[str, Any] | None = None,
    blocks: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Everything, by the names that `--json` promises; "acados" is its best setting, the others carry theirs."""
    best = race.best_acados
    solvers = {}
    for name, record in race.records.items():
        solvers["acados" if record is best else name] = solver_summary(race, record)
    statement = race.problem.transcription.statement
    versions: dict[str, str] = {}
    for record in race.records.values():
        versions.update(record.peer.versions)
    return {
        "machine": {**machine, "versions": {**machine.get("versions", {}), **versions}},
        "ocp": race.problem.name,
        "doc": race.problem.doc,
        "horizon": race.problem.transcription.steps,
        "dimensions": {"coordinates": statement.ndx, "controls": statement.nu},
        "rate_hz": race.problem.rate,
        "samples": len(race.samples),
        "passes": race.passes,
        "saturated": float(np.mean([s.saturated for s in race.samples])),
        "contact": float(np.mean([s.contact for s in race.samples])),
        "exact_references": float(np.mean([s.reference.exact for s in race.samples])),
        "solvers": solvers,
        "ratio_to_acados": _ratios(solvers),
        "growth": dict(growth or {}),
        "blocks": dict(blocks or {}),
        "acados_settings": {name: _microseconds(times) for name, times in race.qualified.items()},
        "skipped": list(race.skipped),
    }


def _ratios(solvers: Mapping[str, Any]) -> dict[str, float]:
    """How many times faster than acados' best setting the generated solver is."""
    if "aerotact" not in solvers or "acados" not in solvers:
        return {}
    ours, theirs = solvers["aerotact"], solvers["acados"]
    pairs = {key: (ours[f"{key}_us"], theirs[f"{key}_us"]) for key in ("p50", "p99", "max")}
    pairs["feedback_p50"] = (ours["feedback"]["p50_us"], theirs["feedback"]["p50_us"])
    return {key: b / a for key, (a, b) in pairs.items() if a and b}


def equal_work(records: Sequence[Record]) -> tuple[int | None, list[Array]]:
    """The least number of factorisations that one solver took for a tenth of the samples at every horizon, and the
    microseconds of these samples by horizon; None if there is no such number.

    Which bounds are active changes with the horizon, and with them what there is to do. These samples are alike.
    """
    counts = [np.median(r.work, axis=0) for r in records]
    common = set.intersection(*(set(c[np.isfinite(c)].tolist()) for c in counts))
    often = [w for w in sorted(common) if all(np.mean(c == w) >= ALIKE for c in counts)]
    if not often:
        return None, []
    return int(often[0]), [r.quiet[c == often[0]] for r, c in zip(records, counts, strict=True)]


def growth_of(steps: Sequence[int], times: Sequence[Array]) -> dict[str, Any]:
    """Median of times (n,) at each horizon, how many they are, and the exponent of the medians over the horizon."""
    medians = [float(np.median(t)) for t in times]
    return {"p50_us": medians, "samples": [int(t.size) for t in times], "exponent": exponent(steps, medians)}


def exponent(steps: Sequence[int], times: Sequence[float]) -> float | None:
    """Exponent of time over horizon by least squares in logarithms; None for fewer than two horizons."""
    if len(steps) < 2:
        return None
    return float(np.polyfit(np.log(steps), np.log(times), 1)[0])
