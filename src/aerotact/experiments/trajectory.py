"""Trajectories: polynomial motions of the tool from rest to rest, between poses or along splines, as set-points.

bodie2021 IV-B: smooth polynomials between constrained set-points, sampled at 100 Hz. A path (`Line`, or `Waypoints`
without rest) says where, `TimeScaled` when, `Chain` what follows what, `Sampled` how often the set-point changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.exceptions import InputError
from aerotact.ports import Array
from aerotact.reference import Reference

_LAWS = {
    5: np.polynomial.Polynomial([0, 0, 0, 10, -15, 6]),
    7: np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20]),
}


def smooth_step(x: Array, order: int = 5) -> tuple[Array, Array, Array]:
    """Polynomial from 0 to 1 whose derivatives up to (order - 1)/2 vanish at both ends; constant outside.

    Args:
        x: any shape; 0 is the start, 1 the end.
        order: 5 (velocity and acceleration vanish) or 7 (the jerk too).

    Returns:
        Value, first and second derivative by x, each of x's shape.

    Raises:
        InputError: another order.
    """
    if order not in _LAWS:
        raise InputError(f"order of a smooth step is {order}; valid: {', '.join(map(str, _LAWS))}")
    inside, law = np.clip(x, 0.0, 1.0), _LAWS[order]
    return law(inside), law.deriv()(inside), law.deriv(2)(inside)


def chord_lengths(points: Array) -> Array:
    """Length of the polygon up to each of the points, m, shape (n,); as times of `Waypoints`, for an even speed.

    Args:
        points: m, shape (n, 3).
    """
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


@dataclass(frozen=True)
class Line:
    """The straight way from one pose to another in one unit of time: position along a line, attitude about one axis.

    The attitude turns by the angle between the two, at most pi; at pi, where either sense would do, the axis is what
    scipy makes of it.

    Attributes:
        p_WE, q_WE: where it starts, m and wxyz, shapes (3,) and (4,).
        p_WE_end, q_WE_end: where it ends.
    """

    p_WE: Array
    q_WE: Array
    p_WE_end: Array
    q_WE_end: Array

    @cached_property
    def _start(self) -> Rotation:
        return Rotation.from_quat(self.q_WE, scalar_first=True)

    @cached_property
    def _turn(self) -> Array:
        return np.asarray((self._start.inv() * Rotation.from_quat(self.q_WE_end, scalar_first=True)).as_rotvec())

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion, one row a time, at constant velocity; also before 0 and after 1."""
        n, zero = len(times), np.zeros((len(times), 3))
        way = self.p_WE_end - self.p_WE
        turns = Rotation.from_rotvec(np.asarray(times)[:, None] * self._turn)
        return {
            "p_WE_d": self.p_WE + np.asarray(times)[:, None] * way,
            "q_WE_d": (self._start * turns).as_quat(scalar_first=True),
            "v_WE_d": np.tile(way, (n, 1)),
            "w_E_d": np.tile(self._turn, (n, 1)),
            "a_WE_d": zero,
            "dw_E_d": zero,
        }


@dataclass(frozen=True)
class TimeScaled:
    """A path run from rest to rest by a polynomial time law; at its first pose before, at its last one after.

    Attributes:
        path: reference of the tool over its own time.
        own: first and last of the path's own time that is used.
        start, stop: when it is run, s.
        order: of the time law, 5 or 7.

    Raises:
        InputError: stop not after start, or an order that is neither.
    """

    path: Reference
    own: tuple[float, float]
    start: float
    stop: float
    order: int = 5

    def __post_init__(self) -> None:
        if not self.start < self.stop:
            raise InputError(f"TimeScaled: start {self.start:g} s and stop {self.stop:g} s; valid: start < stop")
        smooth_step(np.zeros(1), self.order)

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion, one row a time."""
        span, length = self.stop - self.start, self.own[1] - self.own[0]
        s, ds, dds = smooth_step((np.asarray(times) - self.start) / span, self.order)
        rate, change = (length * ds / span)[:, None], (length * dds / span**2)[:, None]
        path = self.path.sample(self.own[0] + length * s)
        return {
            "p_WE_d": path["p_WE_d"],
            "q_WE_d": path["q_WE_d"],
            "v_WE_d": rate * path["v_WE_d"],
            "w_E_d": rate * path["w_E_d"],
            "a_WE_d": rate**2 * path["a_WE_d"] + change * path["v_WE_d"],
            "dw_E_d": rate**2 * path["dw_E_d"] + change * path["w_E_d"],
        }


@dataclass(frozen=True)
class Chain:
    """Motions one after the other.

    Attributes:
        parts: when each takes over, s, increasing, and the motion; the first one also serves the time before.

    Raises:
        InputError: no part, or starts that do not increase.
    """

    parts: Sequence[tuple[float, Reference]]

    def __post_init__(self) -> None:
        starts = [start for start, _ in self.parts]
        if not starts or any(b <= a for a, b in pairwise(starts)):
            raise InputError(f"Chain: parts start at {starts} s; valid: one or more, increasing")

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion, one row a time."""
        times = np.asarray(times)
        starts = [start for start, _ in self.parts]
        active = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
        rows: dict[str, Array] = {}
        for number, (_, motion) in enumerate(self.parts):
            mine = active == number
            for name, values in motion.sample(times[mine]).items():
                rows.setdefault(name, np.full((len(times), values.shape[1]), np.nan))[mine] = values
        return rows


@dataclass(frozen=True)
class Move:
    """Go to a pose and stay there.

    Attributes:
        start, stop: s.
        p_WE, q_WE: where the tool is from `stop` on, m and wxyz, shapes (3,) and (4,).
    """

    start: float
    stop: float
    p_WE: Array
    q_WE: Array


def rest_to_rest(p_WE: Array, q_WE: Array, moves: Sequence[Move], order: int = 5) -> Chain:
    """From a pose through other poses, at rest in each.

    Args:
        p_WE, q_WE: where the tool is at first, m and wxyz.
        moves: in the order of time.
        order: of the polynomials, 5 or 7.

    Raises:
        InputError: no moves, a move without duration, or moves that overlap.
    """
    parts, free = [], -np.inf
    for move in moves:
        if move.start < free:
            raise InputError(
                f"a move starts at {move.start:g} s; valid: {free:g} s, when the one before ends, or later"
            )
        way = Line(p_WE, q_WE, move.p_WE, move.q_WE)
        parts.append((move.start, TimeScaled(way, (0.0, 1.0), move.start, move.stop, order)))
        p_WE, q_WE, free = move.p_WE, move.q_WE, move.stop
    return Chain(parts)


@dataclass(frozen=True)
class Sampled:
    """A reference as an array of set-points: its values at multiples of a period, each held until the next.

    Attributes:
        reference: what is sampled.
        rate: Hz; bodie2021 IV-B has 100 Hz.
    """

    reference: Reference
    rate: float = 100.0

    def sample(self, times: Array) -> dict[str, Array]:
        """Every signal of the reference, one row a time."""
        return dict(self.reference.sample(np.floor(np.asarray(times) * self.rate + 1e-6) / self.rate))
