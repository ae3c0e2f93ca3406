"""Pieces that the experiments at a wall share: the way there, steps of force, and how a force responds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.reference import WithFlags
from aerotact.experiments.trajectory import Move, rest_to_rest
from aerotact.ports import Array
from aerotact.reference import Reference

WALL = 1.0
"""x of the face of the world `wall`, which looks along -x, m."""
CALIBRATE = (1.5, 3.5)
"""Contact-free hover in which the force sensor's tare is learnt, s."""
DEPART, ARRIVE = 4.0, 8.0
"""The tool flies from hover to its set-point, s."""


def in_front_of_wall(model: Model, gap: float) -> Reference:
    """From hover straight to a set-point before the wall (or behind its face), and rest there.

    Args:
        model: hovers with its tool towards the wall.
        gap: of the set-point in front of the wall, m; negative is behind.
    """
    p_WE, q_WE = model.hover_tool
    there = np.array([WALL - gap, p_WE[1], p_WE[2]])
    motion = rest_to_rest(p_WE, q_WE, [Move(DEPART, ARRIVE, there, q_WE)])
    return WithFlags(motion, {"calibrate": CALIBRATE})


@dataclass(frozen=True)
class ForceSteps:
    """A wanted force that jumps; 0 before the first step.

    Attributes:
        steps: time, s, and force from then on, N; in the order of time.
    """

    steps: Sequence[tuple[float, float]]

    def sample(self, times: Array) -> dict[str, Array]:
        """f_ref in N, shape (n, 1)."""
        force = np.zeros(len(times))
        for start, value in self.steps:
            force[np.asarray(times) >= start - 1e-9] = value
        return {"f_ref": force[:, None]}


AT_ONCE = 1.0
"""Time after a step within which its overshoot is looked for, s."""


@dataclass(frozen=True)
class StepResponse:
    """How a force followed a step.

    Attributes:
        rise: time until 90 % of the step was reached for the first time, s; NaN if it never was.
        overshoot: largest excess over the step's end within AT_ONCE, as a share of the step's height.
        settled: mean over the last second, N.
    """

    rise: float
    overshoot: float
    settled: float


def step_response(time: Array, force: Array, span: tuple[float, float], levels: tuple[float, float]) -> StepResponse:
    """Judge one step.

    Args:
        time, force: rows, s and N.
        span: the step and the end of what is judged, s; at least a second.
        levels: wanted before and after the step, N.
    """
    before, after = levels
    rows = (time >= span[0]) & (time < span[1])
    share = (force[rows] - before) / (after - before)
    reached = np.flatnonzero(share >= 0.9)
    last = (time >= span[1] - 1.0) & (time < span[1])
    return StepResponse(
        float(time[rows][reached[0]] - span[0]) if reached.size else float("nan"),
        float(max(share[time[rows] < span[0] + AT_ONCE].max() - 1.0, 0.0)),
        float(force[last].mean()),
    )


def settling_time(time: Array, force: Array, span: tuple[float, float], wanted: float, band: float) -> float:
    """Time from span[0] until a force stays within `band` of `wanted` up to span[1], s; NaN if it does not.

    Args:
        time, force: rows, s and N.
        span: s.
        wanted, band: N.
    """
    rows = (time >= span[0]) & (time < span[1])
    outside = np.flatnonzero(np.abs(force[rows] - wanted) > band)
    if outside.size == 0:
        return 0.0
    if outside[-1] == rows.sum() - 1:
        return float("nan")
    return float(time[rows][outside[-1] + 1] - span[0])


def measured_push(log: Mapping[str, Array]) -> Array:
    """Force on the wall as the controller has it from the force/torque sensor, N: filtered, tare removed."""
    if "normal_force_est" in log:
        return np.asarray(log["normal_force_est"][:, 0])
    return np.asarray(log["f_push_B"][:, 0])


def observed_push(log: Mapping[str, Array]) -> Array | None:
    """Force on the wall as the momentum observer has it, N; None if the controller has none."""
    return np.asarray(-log["f_ext_W"][:, 0]) if "f_ext_W" in log else None
