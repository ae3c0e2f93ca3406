"""Constraints: the limits that an optimal control problem may keep, by name.

Limits of actuators are simple bounds, always hard. The others are rows, smooth functions of the state that must lie
between two limits from the second node on; a soft row may be violated by s > 0 at the cost of
(stage length) * (linear * s + quadratic * s^2 / 2).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.reduced import Reduced
from aerotact.exceptions import ProblemError
from aerotact.mpc.problem import RowEntry
from aerotact.ports import Array, Layout


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

BOUNDS: dict[str, tuple[str, ...]] = {
    "thrust": (),
    "thrust_rate": ("rigid_body",),
    "tilt": ("tilt",),
    "tilt_rate": ("tilt",),
    "torque": ("quasi_static",),
    "servo_rate": ("quasi_static",),
}
"""Bound -> capabilities that it needs."""


@dataclass(frozen=True)
class Row:
    """A kind of row.

    Attributes:
        needs: capabilities of the model.
        limits: keys that its entry must have besides `soft`.
        uses: kinds of stage parameters that it reads, as those of residuals.
        build: (model, x, stage parameters by name) -> values.
        sides: (model, entry) -> lower and upper limits.
        size: numbers a side, given the model.
    """

    name: str
    doc: str
    needs: tuple[str, ...]
    limits: tuple[str, ...]
    uses: tuple[str, ...]
    build: Callable[[Model, Any, dict[str, Any]], Any]
    sides: Callable[[Model, RowEntry], tuple[list[float], list[float]]]
    size: Callable[[Model], int] = lambda _: 1


def _upright(model: Model, x: Any, p: dict[str, Any]) -> Any:
    return so3.rotation(model.state.split(x)["q_WB"])[2, 2]


def _approach_speed(model: Model, x: Any, p: dict[str, Any]) -> Any:
    v_n = ca.dot(p["n_W"], model.tool_twist(x)[0])
    distance = ca.fmax(ca.dot(p["n_W"], model.tool_pose(x)[0]) - p["offset"], 0)
    return v_n + p["approach_speed"] + p["approach_slope"] * distance


def _reduced(model: Model) -> Reduced:
    assert isinstance(model, Reduced)
    return model


def _joint_torque(model: Model, x: Any, p: dict[str, Any]) -> Any:
    return _reduced(model).joint_torque(x, p["n_W"])


def _servo(model: Model, x: Any, p: dict[str, Any]) -> Any:
    return _reduced(model).holding_servo(x, p["n_W"])


def _elbow(model: Model, x: Any, p: dict[str, Any]) -> Any:
    return model.state.split(x)["joint"][_reduced(model).elbows]


def _each(model: Model, limits: list[float] | None) -> list[float]:
    """One number an arm, where one is given for all."""
    given = limits or []
    return given * len(_reduced(model).elbows) if len(given) == 1 else given


def _listed(limits: tuple[Array, Array]) -> tuple[list[float], list[float]]:
    return limits[0].tolist(), limits[1].tolist()


def _symmetric(size: int, entry: RowEntry) -> tuple[list[float], list[float]]:
    largest = entry.max or 0.0
    return [-largest] * size, [largest] * size


def _cone(model: Model, entry: RowEntry) -> tuple[list[float], list[float]]:
    return [math.cos(entry.max or 0.0)], [math.inf]


ROWS = {
    row.name: row
    for row in (
        Row("attitude_tilt", "angle of the base's z axis to the vertical, rad", (), ("max",), (), _upright, _cone),
        Row(
            "approach_speed",
            "speed of the tip towards the surface, at most approach_speed + approach_slope * distance",
            ("tool",),
            (),
            ("contact",),
            _approach_speed,
            lambda _, entry: ([0.0], [math.inf]),
        ),
        Row(
            "workspace",
            "position of the tool, m, W, within a box",
            ("tool",),
            ("lower", "upper"),
            (),
            lambda model, x, _: model.tool_pose(x)[0],
            lambda _, entry: (entry.lower or [], entry.upper or []),
            lambda _: 3,
        ),
        Row(
            "joint",
            "joint angles of the working arms within their ranges",
            ("quasi_static",),
            (),
            (),
            lambda model, x, _: model.state.split(x)["joint"],
            lambda model, _: _listed(_reduced(model).joint_limits),
            lambda model: _reduced(model).joints,
        ),
        Row(
            "servo",
            "servo angles of the working arms within their ranges",
            ("quasi_static",),
            (),
            (),
            _servo,
            lambda model, _: _listed(_reduced(model).servo_limits),
            lambda model: _reduced(model).joints,
        ),
        Row(
            "joint_torque",
            "torques of the working arms' springs, N m",
            ("quasi_static",),
            ("max",),
            (),
            _joint_torque,
            lambda model, entry: _symmetric(_reduced(model).joints, entry),
            lambda model: _reduced(model).joints,
        ),
        Row(
            "elbow",
            "angles of the working arms' last joints, rad, away from straight",
            ("quasi_static",),
            ("lower", "upper"),
            (),
            _elbow,
            lambda model, entry: (_each(model, entry.lower), _each(model, entry.upper)),
            lambda model: len(_reduced(model).elbows),
        ),
        Row(
            "swing",
            "angles of the passive joints, if there are any, rad",
            ("quasi_static",),
            ("max",),
            (),
            lambda model, x, _: model.state.split(x)["passive"],
            lambda model, entry: _symmetric(_reduced(model).passive, entry),
            lambda model: _reduced(model).passive,
        ),
    )
}
CONSTRAINTS = {**BOUNDS, **{row.name: row.needs for row in ROWS.values()}}
"""Constraint -> capabilities that it needs."""


def make_rows(
    path: Path, model: Model, entries: dict[str, Literal["hard"] | RowEntry], stage: Layout, terminal: float
) -> Rows:
    """Rows of the named constraints, in the order of the file.

    Args:
        path: of the ocp file, for errors.
        model: of the robot.
        entries: of the file's [constraints]; those that are bounds are passed over.
        stage: layout of a stage's parameters.
        terminal: seconds by which violations at the last node count.

    Raises:
        ProblemError: an entry lacks a limit, has one that is not its own, or limits that leave no room.
    """
    chosen = [
        (ROWS[name], RowEntry() if entry == "hard" else entry)
        for name, entry in entries.items()
        if name in ROWS and ROWS[name].size(model)
    ]
    if not chosen:
        return NO_ROWS
    sides = [_sides(path, model, row, entry) for row, entry in chosen]
    penalties = [entry.penalty for _, entry in chosen]
    counts = [len(lower) for lower, _ in sides]

    def build(x: Any, stage_parameters: Any) -> Any:
        parts = stage.split(stage_parameters)
        return ca.vertcat(*[row.build(model, x, parts) for row, _ in chosen])

    return Rows(
        build,
        np.concatenate([lower for lower, _ in sides]),
        np.concatenate([upper for _, upper in sides]),
        np.repeat([linear for linear, _ in penalties], counts),
        np.repeat([quadratic for _, quadratic in penalties], counts),
        terminal,
    )


def _sides(path: Path, model: Model, row: Row, entry: RowEntry) -> tuple[list[float], list[float]]:
    key = f"constraints.{row.name}"
    for name in ("max", "lower", "upper"):
        if (getattr(entry, name) is not None) != (name in row.limits):
            given = "is no limit of this constraint" if name not in row.limits else "is missing"
            raise ProblemError(path, f"{key}.{name}", given, f"valid: soft, {', '.join(row.limits)}".rstrip(", "))
    (lower, upper), size = row.sides(model, entry), row.size(model)
    if len(lower) != size or len(upper) != size or not all(a < b for a, b in zip(lower, upper, strict=True)):
        raise ProblemError(path, key, f"has limits {lower} to {upper}", f"give {size} numbers a side, lower < upper")
    return lower, upper


def make_bounds(model: Model, names: list[str]) -> Bounds:
    """Bounds of the named constraints (each a key of BOUNDS)."""
    if isinstance(model, Reduced):
        return _control_bounds(model, names)
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


def _control_bounds(model: Reduced, names: list[str]) -> Bounds:
    """Bounds of a predictor whose states no actuator integrates."""
    lower, upper = np.full(model.control.size, -np.inf), np.full(model.control.size, np.inf)
    rates = model.servo_rate_limits
    torques = model.hover_torque - model.torque_limits, model.hover_torque + model.torque_limits
    for name, port, limits in (
        ("thrust", "thrust", model.thrust_limits),
        ("torque", "torque", torques),
        ("servo_rate", "joint_rate", rates),
    ):
        if name in names:
            lower[model.control.slice(port)], upper[model.control.slice(port)] = limits
    return Bounds((), np.zeros(0), np.zeros(0), lower, upper)
