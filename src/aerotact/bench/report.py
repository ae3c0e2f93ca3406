"""Report: a summary as a Markdown page and its figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from aerotact.bench.blocks import BATCHES, STEPS
from aerotact.bench.run import Race
from aerotact.plots import COLOURS, label, panels, save

PERCENTILES = ("p50", "p99", "max")
SHOWN = ("aerotact", "aerotact single", "acados", "hpipm 1e-6", "osqp 1e-3", "casadi qrqp")
Rows = Sequence[Sequence[str]]


def table(header: Sequence[str], rows: Rows) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def number(value: float | None, form: str = ".0f") -> str:
    """A number, or a dash where there is none."""
    return "–" if value is None else format(value, form)


def _microseconds(value: float | None) -> str:
    """Microseconds; from 10 ms in ms."""
    if value is not None and value >= 1e4:
        return f"{value / 1e3:.0f} ms"
    return number(value, ".1f" if value is not None and value < 100 else ".0f")


def _times(values: Mapping[str, float | None]) -> str:
    return " / ".join(_microseconds(values[f"{key}_us"]) for key in ("p50", "p99", "max"))


def time_rows(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the main table."""
    header = ["solver", "p50", "p99", "max", "prepare p50", "feedback p50", "p99"]
    header += ["raw p50", "p99", "late", "samples"]
    rows = []
    for name, s in summary["solvers"].items():
        feedback, raw = s["feedback"], s["raw"]
        times = [s["p50_us"], s["p99_us"], s["max_us"], s["prepare"]["p50_us"]]
        times += [feedback["p50_us"], feedback["p99_us"], raw["p50_us"], raw["p99_us"]]
        late = f"{100 * s['deadline_misses'] / s['solves']:.1f} %"
        rows.append([name, *map(_microseconds, times), late, str(s["samples"])])
    return header, rows


def accuracy_rows(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the accuracy table: of those that were judged."""
    header = ["solver", "error of u0: median", "p99", "max", "stationarity", "feasibility", "complementarity", "usable"]
    rows = []
    for name, s in summary["solvers"].items():
        error = s["error_u0"]
        if error["median"] is None:
            continue
        residuals = [" / ".join(number(r[key], ".0e") for key in ("p50", "max")) for r in s["residuals"].values()]
        errors = [number(error[key], ".1e") for key in ("median", "p99", "max")]
        rows.append([name, *errors, *residuals, f"{100 * s['usable']:.1f} %"])
    return header, rows


def _phase_rows(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    names = list(next(iter(summary["solvers"].values()))["phases"])
    rows = []
    for name, s in summary["solvers"].items():
        phases = s["phases"]
        cells = [f"{_times(phases[p])} ({phases[p]['samples']})" for p in names]
        rows.append([name, *cells])
    return ["solver", *names], rows


def _growth_rows(growth: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    steps = [str(n) for n in growth["steps"]]
    rows = [
        [
            name,
            *(f"{_microseconds(v)} ({n})" for v, n in zip(s["p50_us"], s["samples"], strict=True)),
            number(s["exponent"], ".2f"),
        ]
        for name, s in growth["solvers"].items()
    ]
    return ["solver", *(f"N = {n}" for n in steps), "exponent"], rows


def page(summary: Mapping[str, Any], figures: Sequence[Path] = ()) -> str:
    """The whole page."""
    machine = summary["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    ratios = summary["ratio_to_acados"]
    exact = summary["exact_references"]
    verified = "" if exact == 1 else f" in {100 * exact:.1f} % of the samples, else by an interior point at 1e-10"
    parts = [
        f"# Benchmark {summary['ocp']}",
        f"{summary['doc']}. {summary['horizon']} intervals, {summary['rate_hz']:g} Hz.",
        f"{machine['cpu']}; {machine['cores']} cores; {machine['system']}; load at the start {machine['load']}; "
        f"{machine['compiler']}; {versions}.",
        f"{summary['samples']} samples of one closed loop with large steps of the reference; a bound is active in "
        f"{100 * summary['saturated']:.0f} % of them, the tool touches in {100 * summary['contact']:.0f} %. Every "
        "solver is given the same trajectory, parameters and measured state at each sample, in one process, by turns.",
        f"Times in us. That of a sample is the smallest of {summary['passes']} passes, of those in which the system "
        'did not take the processor away if there is one; "raw" are all of them as they were; "late" are raw times '
        "beyond one period. They are each solver's own, taken inside C by the monotonic clock, but for CasADi and "
        "IPOPT, which are timed around the call, and OSQP, whose solve alone counts. Slow solvers see some of the "
        "samples, once.",
        "## Time",
        table(*time_rows(summary)),
    ]
    if ratios:
        parts.append(
            "acados' best setting over aerotact: "
            + ", ".join(f"{key} {value:.1f}" for key, value in ratios.items())
            + '. "acados" is the form and setting with the smallest median.'
        )
    parts += [
        "## Accuracy",
        "Error of the first control in units of its range, against the solution of the same quadratic programme to "
        f"round-off, by an active set that is verified{verified}. "
        "acados in quaternion form is judged by its own quadratic programme. "
        "Residuals, median / max, are recomputed from the answer: gradient in the controls, constraints, multiplier "
        "times distance to the bound.",
        table(*accuracy_rows(summary)),
    ]
    left = summary["solvers"].get("ipopt", {}).get("one_iteration_leaves", {})
    if left.get("p50") is not None:
        parts.append(
            "What one exact iteration leaves undone, the difference of its first control to that of the converged "
            f"nonlinear programme (IPOPT): median {left['p50']:.1e}, max {left['max']:.1e} of the range."
        )
    if summary["acados_settings"]:
        rows = [
            [name, *(_microseconds(s[f"{k}_us"]) for k in PERCENTILES)]
            for name, s in summary["acados_settings"].items()
        ]
        parts += [
            "## Settings of acados",
            "Form of the problem / intervals after partial condensing; HPIPM's mode is SPEED if not named. Times in "
            "us on the first samples, these settings by turns. The fastest of each form races.",
            table(["setting", *PERCENTILES], rows),
        ]
    parts += ["## Phases", "p50 / p99 / max, us (samples).", table(*_phase_rows(summary))]
    if summary["growth"]:
        parts += [
            "## Growth with the horizon",
            "Median, us (samples); the exponent is that of time over N, by least squares in logarithms. A longer "
            "horizon has other active bounds, and more or less to do for them. Preparation does the same work whatever "
            "they are; so do, but for what the bounds themselves cost, the samples that took the same number of "
            "factorisations, the least number that a tenth of the samples took at every horizon.",
            table(*_growth_rows(summary["growth"])),
        ]
    parts += [
        "## Building and memory",
        table(
            ["solver", "generate and compile, s", "workspace, KiB", "code, KiB"],
            [
                [
                    name,
                    number(s["build_seconds"], ".1f"),
                    *(number(s["bytes"][k] / 1024) if k in s["bytes"] else "–" for k in ("workspace", "code")),
                ]
                for name, s in summary["solvers"].items()
            ],
        ),
    ]
    if summary["blocks"]:
        rows = [
            [
                robot,
                name,
                number(b["p50_us"], ".2f"),
                number(b["max_us"], ".2f"),
                number(b["bytes"]["workspace"] / 1024, ".1f"),
            ]
            for robot, blocks in summary["blocks"].items()
            for name, b in blocks.items()
        ]
        parts += [
            "## Laws and estimators",
            f"Mean time of a step in batches of {STEPS}: median and slowest of {BATCHES} batches.",
            table(["robot", "block", "step, us", "slowest batch, us", "workspace, KiB"], rows),
        ]
    parts += ["## Settings", table(["solver", "settings"], [[n, s["settings"]] for n, s in summary["solvers"].items()])]
    parts += [f"Not here: {line}" for line in summary["skipped"]]
    parts += [f"![{figure.stem}]({figure.name})" for figure in figures]
    return "\n\n".join(parts) + "\n"


def plot(race: Race, summary: Mapping[str, Any], folder: Path) -> list[Path]:
    """Distribution of times, error over time, growth."""
    names = [n for n in SHOWN if n in summary["solvers"]]
    best = race.best_acados
    figure, axes = panels(1, 3 if summary["growth"] else 2, f"{summary['ocp']}: {summary['doc']}", 3.0, 4.4)
    times, errors = axes[0, :2]
    for colour, name in zip(COLOURS, names, strict=False):
        record = best if name == "acados" and best is not None else race.records[name]
        ordered = np.sort(record.quiet)
        times.step(ordered, np.arange(1, ordered.size + 1) / ordered.size, color=colour, label=name)
        if record.error.size:
            errors.loglog(record.quiet, np.maximum(record.error, 1e-16), ".", ms=2.5, color=colour, alpha=0.6)
    times.set_xscale("log")
    times.set_ylim(0.0, 1.03)
    label(times, "distribution", "share of samples", "time in us")
    times.legend(loc="lower right")
    label(errors, "accuracy", "error of u0, share of its range", "time in us")
    for axis in (times, errors):
        _plain_ticks(axis.xaxis)
    if summary["growth"]:
        growth, steps = axes[0, 2], summary["growth"]["steps"]
        solvers = summary["growth"]["solvers"]
        whose = {name: name.partition(",")[0] for name in solvers}
        colours = dict(zip(dict.fromkeys(whose.values()), COLOURS, strict=False))
        for name, s in solvers.items():
            style = "o-" if name in colours else "o--" if name.endswith("preparation") else "o:"
            slope = number(s["exponent"], ".2f")
            growth.loglog(steps, s["p50_us"], style, ms=4, color=colours[whose[name]], label=f"{name}: N^{slope}")
        label(growth, "growth", "median in us", "intervals N")
        growth.legend(loc="upper left")
        low, high = growth.get_ylim()
        growth.set_ylim(low, high * (high / low) ** 0.35)  # room for the legend
        growth.set_xticks(steps, [str(n) for n in steps])
        growth.xaxis.set_minor_locator(NullLocator())
        _plain_ticks(growth.yaxis)
    return [save(figure, folder / f"{summary['ocp']}.png")]


def _plain_ticks(axis: Any) -> None:
    """Ticks of a logarithmic axis at 1, 2, 5, 10, 20 ..., written as numbers; at powers of ten if they are many."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 300 else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
