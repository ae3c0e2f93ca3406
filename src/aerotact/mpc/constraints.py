"""Constraints: the limits that an optimal control problem may keep, by name.

Limits of actuators are simple bounds, always hard. The others are rows, smooth functions of the state that must lie
between two limits from the second node on; a soft row may be violated by s > 0 at the cost of
(stage length) * (linear * s + quadratic * s^2 / 2).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.ports import Array


@dataclass(frozen=True)
class Bounds:
    """Simple bounds of an OCP.

    Attributes:
        states: indices into x of the bounded states, all of them plain coordinates (none of the attitude).
        x_lower, x_upper: their bounds, shape (len(states),).
        u_lower, u_upper: bounds of the controls, shape (nu,), infinite where there is none.
        lag: s, shape (nu,), if the command of the first interval, state + lag * control, is bounded too; the bounded
            states are then those that the controls integrate, in their order.
    """

    states: tuple[int, ...]
    x_lower: Array
    x_upper: Array
    u_lower: Array
    u_upper: Array
    lag: Array | None = None


@dataclass(frozen=True)
class Rows:
    """Inequality rows of an OCP.

    Attributes:
        build: (x, stage parameters) -> the rows' values, shape (size,).
        lower, upper: limits, shape (size,), infinite where there is none.
        linear, quadratic: penalty of a violation, shape (size,); a hard row has linear = infinity.
        terminal: seconds by which a violation at the last node counts.
    """

    build: Callable[[Any, Any], Any]
    lower: Array
    upper: Array
    linear: Array
    quadratic: Array
    terminal: float

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.lower)

    @property
    def soft(self) -> tuple[bool, ...]:
        """Which rows are soft."""
        return tuple(bool(v) for v in np.isfinite(self.linear))


NO_ROWS = Rows(lambda _x, _stage: None, *(np.zeros(0),) * 4, terminal=0.0)

CONSTRAINTS = {
    "thrust": "lowest and highest thrust at every node, and of the command that is sent",
    "thrust_rate": "lowest and highest rate of the actual thrust",
}


def make_bounds(model: Model, names: list[str]) -> Bounds:
    """Bounds of the named constraints (each a key of CONSTRAINTS)."""
    n = model.rotors
    where = model.state.slice("thrust")
    unbounded = np.full(n, np.inf)
    thrust, rate = "thrust" in names, "thrust_rate" in names
    lower, upper = model.thrust_limits if thrust else (np.zeros(0), np.zeros(0))
    u_lower, u_upper = model.thrust_rate_limits if rate else (-unbounded, unbounded)
    states = tuple(range(where.start, where.stop)) if thrust else ()
    return Bounds(states, lower, upper, u_lower, u_upper, model.time_constants if thrust else None)
