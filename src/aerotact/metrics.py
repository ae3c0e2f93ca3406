"""Metrics: numbers that every experiment reports, judged on the plant's truth and not on what a controller believes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter

from aerotact.log import Log
from aerotact.ports import Array
from aerotact.robot import Robot

# A limit counts as violated beyond this share of its range; rounding is not a violation.
LIMIT_TOLERANCE = 1e-6
FORCE_BAND = 5.0
"""Cut-off of the second-order Butterworth filter behind `force_rmse_band`, Hz: bodie2021's of the force sensor."""
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


def push_force(columns: Mapping[str, Array]) -> Array:
    """Force of the tool on a surface along its normal, N, shape (rows,), from f_contact_W and n_W of a log."""
    return np.einsum("ij,ij->i", columns["f_contact_W"], columns["n_W"])


def in_band(force: Array, period: float) -> Array:
    """A force behind the Butterworth filter of FORCE_BAND, which starts at rest at the first value.

    Args:
        force: N, shape (rows,).
        period: s between rows.
    """
    b, a = butter(2, FORCE_BAND, fs=1.0 / period)
    return np.asarray(lfilter(b, a, force - force[:1]) + force[:1])


def standard_metrics(log: Log, robot: Robot, window: slice | None = None) -> dict[str, Metric]:
    """Metrics that every run has; those of contact are None in free flight.

    Args:
        log: of the run.
        robot: whose limits count.
        window: rows that are judged for the tool's error and for contact; all if None. Limits are judged on all rows.

    Where the log has a wanted force f_ref, contact is judged in those rows of the window that want one.
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
    wanting = _wanting(log, rows)
    pressed = np.arange(len(log.time))[rows] if wanting is None else wanting
    # The reference is compared where it is fresh: between the steps of a slow controller the tool has moved on.
    fresh = log.stepped(rows)
    aim = next((name for name in ("p_WE_r", "p_WE_d") if name in log), None)
    tool = rmse(log["p_WE"][fresh] - log[aim][fresh]) if aim and len(fresh) else None
    force, band = _force_errors(log, wanting) if touched else (None, None)
    solve = log.solve_times
    statuses = (log.statuses, *log.inner_statuses.values())
    total = sum(count for found in statuses for count in found.values())
    usable = sum(found.get(s, 0) for found in statuses for s in ("OK", "MAX_ITERATIONS", "DEADLINE"))
    values: Mapping[str, float | None] = {
        "force_rmse": force,
        "force_rmse_band": band,
        "tool_rmse": tool,
        "peak_force": float(contact.max()) if touched else None,
        "airborne": float((contact[pressed] == 0).mean()) if touched and judged else None,
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


def _wanting(log: Log, rows: slice) -> Array | None:
    """Indices of those rows in which a force is wanted; None if there are none."""
    if "f_ref" not in log:
        return None
    indices = np.arange(len(log.time))[rows]
    wanting = indices[log["f_ref"][indices, 0] > 0.0]
    return wanting if len(wanting) else None


def _force_errors(log: Log, wanting: Array | None) -> tuple[float | None, float | None]:
    """RMS of the true contact force along the normal minus f_ref, N, and the same of the force in the band."""
    if wanting is None or "n_W" not in log:
        return None, None
    force, wanted = push_force(log.columns), log["f_ref"][wanting, 0]
    return rmse(force[wanting] - wanted), rmse(in_band(force, log.period)[wanting] - wanted)


def _tilt_violations(log: Log, robot: Robot) -> tuple[int | None, int | None]:
    """Rows in which a tilt angle was commanded beyond its range, and a servo beyond its rate; None if nothing tilts.

    The actual angle is not judged: it cannot leave what the servo is told but by a misaligned zero.
    """
    if not robot.tilts:
        return None, None
    angles, rates = np.array([t.angle for t in robot.tilts]).T, np.array([t.rate for t in robot.tilts]).T
    return violations(log["tilt_cmd"], *angles), violations(log["tilt_rate_cmd"], *rates)
