"""Residual blocks: what an optimal control problem may ask for, by name.

A residual block turns state, controls and stage parameters into terms; each term has a weight of its own, a parameter
of the generated controller. The cost is the sum over stages of (stage length) * weight * term^2 / 2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model


@dataclass(frozen=True)
class Term:
    """One weighted part of a residual: `size` numbers of the given unit, or as many as model.actuators has under it."""

    key: str
    size: int | str
    unit: str

    def count(self, model: Model) -> int:
        """Numbers that it has for a model."""
        return self.size if isinstance(self.size, int) else model.actuators[self.size].size


@dataclass(frozen=True)
class Residual:
    """A residual block.

    Attributes:
        target: which motion of the tool its stage parameters describe: "desired", "admittance" or none.
        controls: it depends on the controls, so that it has no terminal part.
        trim: its stage parameters are the actuators' values of least thrust.
        build: (model, x, u, stage parameters by name) -> one expression a term.
    """

    name: str
    doc: str
    needs: tuple[str, ...]
    terms: tuple[Term, ...]
    build: Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]
    target: str | None = None
    controls: bool = False
    trim: bool = False


def _pose(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        p_WE, q_WE = model.tool_pose(x)
        return p_WE - p[f"p_WE_{suffix}"], so3.local(p[f"q_WE_{suffix}"], q_WE)

    return build


def _twist(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        v_WE, w_E = model.tool_twist(x)
        return v_WE - p[f"v_WE_{suffix}"], w_E - p[f"w_E_{suffix}"]

    return build


def _motion(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    pose, twist = _pose(suffix), _twist(suffix)

    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        return (*pose(model, x, u, p), *twist(model, x, u, p))

    return build


def _thrust(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (model.state.split(x)["thrust"] - p["thrust_trim"],)


def _tilt(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (model.state.split(x)["tilt"] - p["tilt_trim"],)


def _rate(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (model.control.split(u)["thrust_rate"],)


def _tilt_rate(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (model.control.split(u)["tilt_rate"],)


_POSE = (Term("position", 3, "1/m^2"), Term("attitude", 3, "1/rad^2"))
_TWIST = (Term("linear", 3, "s^2/m^2"), Term("angular", 3, "s^2/rad^2"))

RESIDUALS = {
    r.name: r
    for r in (
        Residual("tool_pose", "tool pose minus desired pose", ("tool",), _POSE, _pose("d"), "desired"),
        Residual("twist", "tool twist minus desired twist", ("tool",), _TWIST, _twist("d"), "desired"),
        Residual(
            "admittance",
            "tool motion minus the desired motion moved by the virtual mass-spring-damper (ryll2019 (27)), predicted",
            ("tool",),
            (*_POSE, *_TWIST),
            _motion("r"),
            "admittance",
        ),
        Residual(
            "thrust",
            "thrust minus the least thrust that holds the target motion against the estimated wrench",
            ("six_axis_wrench",),
            (Term("thrust", "thrust", "1/N^2"),),
            _thrust,
            trim=True,
        ),
        Residual(
            "tilt",
            "tilt angle minus that of the least thrust that holds the target motion against the estimated wrench",
            ("six_axis_wrench", "tilt"),
            (Term("tilt", "tilt", "1/rad^2"),),
            _tilt,
            trim=True,
        ),
        Residual("rate", "thrust rate", (), (Term("rate", "thrust", "s^2/N^2"),), _rate, controls=True),
        Residual(
            "tilt_rate", "tilt rate", ("tilt",), (Term("tilt_rate", "tilt", "s^2/rad^2"),), _tilt_rate, controls=True
        ),
    )
}
