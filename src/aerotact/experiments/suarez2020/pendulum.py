"""What logs say of the pendulum and of the platform that carries it."""

from collections.abc import Mapping

import numpy as np

from aerotact.ports import Array


def tilt(q_WB: Array) -> Array:
    """Angle of the base from level, rad, row by row, whatever its yaw."""
    return np.asarray(2 * np.arcsin(np.minimum(np.hypot(q_WB[:, 1], q_WB[:, 2]), 1.0)))


def swing(log: Mapping[str, Array], released: float = 0.0) -> Array:
    """Angle of the pendulum, the first joint, from where it hangs in hover, rad, row by row.

    Args:
        log: columns of a run.
        released: how far from there it began, rad.
    """
    angle = log["joint"][:, 0]
    return np.asarray(angle - (angle[0] - released))


def settled(time: Array, values: Array, bound: float) -> float:
    """Time, s, from the first row to the last in which |values| is above the bound; 0 if none is."""
    above = np.flatnonzero(np.abs(values) > bound)
    return float(time[above[-1]] - time[0]) if above.size else 0.0
