"""Metrics: numbers that every experiment reports, judged on the plant's truth and not on what a controller believes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aerotact.log import Log
from aerotact.ports import Array
from aerotact.robot import Robot

# A limit counts as violated beyond this share of its range; rounding is not a violation.
LIMIT_TOLERANCE = 1e-6
UNITS = {
    "force_rmse": "N",
    "force_rmse_band": "N",
    "tool_rmse": "m",
    "peak_force": "N",
    "airborne": "1",
    "violations_thrust": "1",
    "violations_thrust_rate": "1",
    "violations_tilt": "1",
    "violations_tilt_rate": "1",
    "solve_p50": "s",
    "solve_p99": "s",
    "solve_max": "s",
    "stand_ins": "1",
    "effort": "N^1.5 s",
    "real_time_factor": "1",
}


@dataclass(frozen=True)
class Metric:
    """A number with its unit; None where it does not apply."""

    value: float | None
    unit: str


def rmse(error: Array) -> float:
    """Root of the mean squared length of the rows."""
    flat = np.asarray(error, dtype=float).reshape(len(error), -1)
    return float(np.sqrt((flat**2).sum(axis=1).mean()))


def violations(values: Array, lower: Array, upper: Array) -> int:
    """Rows in which any column leaves its range by more than LIMIT_TOLERANCE of it."""
    slack = LIMIT_TOLERANCE * (upper - lower)
    return int(((values < lower - slack) | (values > upper + slack)).any(axis=1).sum())


def standard_metrics(log: Log, robot: Robot, window: slice | None = None) -> dict[str, Metric]:
    """Metrics that every run has; those of contact are None in free flight.

    Args:
        log: of the run.
        robot: whose limits count.
        window: rows that are judged for the tool's error and for contact; all if None. Limits are judged on all rows.
    """
    rows = slice(0, len(log.time)) if window is None else window
    rate_lower, rate_upper = np.array([r.thrust_rate for r in robot.rotors]).T
    # What was commanded is judged as well: the actual thrust cannot leave the range that the plant clips to.
    lower, upper = np.array([r.thrust for r in robot.rotors]).T
    commanded = violations(log["thrust_cmd"], lower, upper)
    tilt, tilt_rate = _tilt_violations(log, robot)
    contact = np.linalg.norm(log["f_contact_W"], axis=1) if "f_contact_W" in log else np.zeros(len(log.time))
    touched = bool((contact > 0).any())
    judged = len(log.time[rows]) > 0
    # The reference is compared where it is fresh: between the steps of a slow controller the tool has moved on.
    fresh = log.stepped(rows)
    tool = rmse(log["p_WE"][fresh] - log["p_WE_r"][fresh]) if "p_WE_r" in log and len(fresh) else None
    solve = log.solve_times
    total = sum(log.statuses.values())
    usable = sum(log.statuses.get(s, 0) for s in ("OK", "MAX_ITERATIONS", "DEADLINE"))
    values: Mapping[str, float | None] = {
        "force_rmse": None,
        "force_rmse_band": None,
        "tool_rmse": tool,
        "peak_force": float(contact.max()) if touched else None,
        "airborne": float((contact[rows] == 0).mean()) if touched and judged else None,
        "violations_thrust": max(commanded, violations(log["thrust"], lower, upper)),
        "violations_thrust_rate": violations(log["thrust_rate"], rate_lower, rate_upper),
        "violations_tilt": tilt,
        "violations_tilt_rate": tilt_rate,
        "solve_p50": float(np.percentile(solve, 50)) if solve.size else None,
        "solve_p99": float(np.percentile(solve, 99)) if solve.size else None,
        "solve_max": float(solve.max()) if solve.size else None,
        "stand_ins": total - usable,
        "effort": float((np.clip(log["thrust"], 0, None) ** 1.5).sum() * log.period),
        "real_time_factor": float(len(log.time) * log.period / log.wall) if log.wall > 0 else None,
    }
    return {name: Metric(value, UNITS[name]) for name, value in values.items()}


def _tilt_violations(log: Log, robot: Robot) -> tuple[int | None, int | None]:
    """Rows in which a tilt angle was commanded beyond its range, and a servo beyond its rate; None if nothing tilts.

    The actual angle is not judged: it cannot leave what the servo is told but by a misaligned zero.
    """
    if not robot.tilts:
        return None, None
    angles, rates = np.array([t.angle for t in robot.tilts]).T, np.array([t.rate for t in robot.tilts]).T
    return violations(log["tilt_cmd"], *angles), violations(log["tilt_rate_cmd"], *rates)
