"""Constraints: the limits that an optimal control problem may keep, by name."""

from dataclasses import dataclass

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
            states are then those that the controls integrate, in their order, with infinite bounds where there is none.
    """

    states: tuple[int, ...]
    x_lower: Array
    x_upper: Array
    u_lower: Array
    u_upper: Array
    lag: Array | None = None


CONSTRAINTS = {
    "thrust": "lowest and highest thrust at every node, and of the command that is sent",
    "thrust_rate": "lowest and highest rate of the actual thrust",
    "tilt": "lowest and highest tilt angle at every node, and of the command that is sent",
    "tilt_rate": "lowest and highest rate of the actual tilt angle",
}
NEEDS = {"tilt": "tilt", "tilt_rate": "tilt"}  # capabilities, by constraint


def make_bounds(model: Model, names: list[str]) -> Bounds:
    """Bounds of the named constraints (each a key of CONSTRAINTS)."""
    known = {"thrust": (model.thrust_limits, model.thrust_rate_limits)}
    if model.tilts:
        known["tilt"] = (model.tilt_limits, model.tilt_rate_limits)
    values: list[tuple[Array, Array]] = []
    rates: list[tuple[Array, Array]] = []
    for port in model.actuators:
        unbounded = np.full(port.size, np.inf)
        limits, rate_limits = known[port.name]
        values.append(limits if port.name in names else (-unbounded, unbounded))
        rates.append(rate_limits if f"{port.name}_rate" in names else (-unbounded, unbounded))
    lower, upper = np.hstack(values)
    u_lower, u_upper = np.hstack(rates)
    if not any(port.name in names for port in model.actuators):
        return Bounds((), lower[:0], upper[:0], u_lower, u_upper)
    start = model.state.size - model.actuators.size
    states = tuple(range(start, model.state.size))
    return Bounds(states, lower, upper, u_lower, u_upper, model.actuator_time_constants)
