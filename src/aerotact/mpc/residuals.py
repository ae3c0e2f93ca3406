"""Residual blocks: what an optimal control problem may ask for, by name.

A residual block turns state, controls and stage parameters into terms; each term has a weight of its own, a parameter
of the generated controller. The cost is the sum over stages of (stage length) * weight * term^2 / 2.

Where a problem knows of a surface (one of its residuals uses "contact"), pose and speed along the surface's normal give
way to approach and force while a force is wanted.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.contact import contact_motion, tool_wrench
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion
from aerotact.laws.bodie2021 import impedance as soft
from aerotact.mpc.prediction import surface, wrench


@dataclass(frozen=True)
class Term:
    """One weighted part of a residual: `size` numbers of the given unit, or as many as a port of the
    model, or its attribute, has."""

    key: str
    size: int | str
    unit: str

    def count(self, model: Model) -> int:
        """Numbers that it has for a model."""
        if isinstance(self.size, int):
            return self.size
        layouts = (model.actuators, model.state, model.control)
        found = [layout[self.size].size for layout in layouts if self.size in layout]
        return found[0] if found else int(getattr(model, self.size))


@dataclass(frozen=True)
class Residual:
    """A residual block.

    Attributes:
        uses: kinds of stage parameters that it reads: "desired" or "admittance" motion of the tool, "base", that of the
            base that gives the desired one, "trim", "contact"; and of parameters: "impedance".
        controls: it depends on the controls, so that it has no terminal part.
        build: (model, x, u, stage parameters by name) -> one expression a term.
    """

    name: str
    doc: str
    needs: tuple[str, ...]
    terms: tuple[Term, ...]
    build: Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]
    uses: tuple[str, ...] = ()
    controls: bool = False


def tangential_error(p: dict[str, Any], error: Any) -> Any:
    """An error of position without its part along the surface's normal, while a force is wanted."""
    if "push" not in p:
        return error
    return error - p["push"] * ca.dot(p["n_W"], error) * p["n_W"]


def _pose(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        p_WE, q_WE = model.tool_pose(x)
        error = tangential_error(p, p_WE - p[f"p_WE_{suffix}"])
        return error, so3.local(p[f"q_WE_{suffix}"], q_WE)

    return build


def _twist(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        v_WE, w_E = model.tool_twist(x)
        wanted = p[f"v_WE_{suffix}"]
        if "push" in p:
            along = ca.dot(p["n_W"], wanted) + p["approach"] * p["v_approach"]
            wanted = wanted - p["push"] * along * p["n_W"]
        return v_WE - wanted, w_E - p[f"w_E_{suffix}"]

    return build


def _motion(suffix: str) -> Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]:
    pose, twist = _pose(suffix), _twist(suffix)

    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        return (*pose(model, x, u, p), *twist(model, x, u, p))

    return build


def _thrust(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (model.state.split(x)["thrust"] - p["thrust_trim"],)


def _base_pose(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    s = model.state.split(x)
    return s["p_WB"] - p["p_WB_d"], so3.local(p["q_WB_d"], s["q_WB"])


def _impedance(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    """Accelerations less those of the target dynamics, bodie2021 (7) with (8)-(11), in B."""
    s, robot = model.state.split(x), model.robot
    base = BaseMotion(s["p_WB"], s["q_WB"], s["v_WB"], s["w_B"])
    reference = BaseMotion(p["p_WB_d"], p["q_WB_d"], p["v_WB_d"], p["w_B_d"], p["a_WB_d"], p["dw_B_d"])
    gains = soft.Impedance(**{f.name: p[f.name] for f in fields(soft.Impedance)})
    moved = contact_motion(model, x, wrench(p), surface(p))
    felt = wrench(p) + tool_wrench(model, s["q_WB"], moved.f_tool_W)
    R_BW = so3.rotation(s["q_WB"]).T
    f_B = ca.mtimes(R_BW, felt[0:3])
    tau_B = felt[3:6] + ca.cross(ca.DM(robot.p_BC), f_B)
    errors = soft.tracking_errors(base, reference)
    ratio = soft.mass_ratio(gains, ca.DM(robot.R_BE[:, 2]), p["near"])
    f_imp, tau_imp = soft.impedance_wrench(gains, errors, ratio, ca.DM(3, 3), ca.DM(robot.p_BE), f_B, tau_B)
    a_ref, dw_ref = soft.reference_acceleration(base, reference)
    a_B = ca.mtimes(R_BW, moved.a_WB) - ca.cross(s["w_B"], ca.mtimes(R_BW, s["v_WB"]))
    linear = a_B - a_ref - (f_imp + f_B) / robot.mass
    angular = moved.dw_B - dw_ref - ca.mtimes(model.inverse_inertia, tau_imp + tau_B)
    return linear, angular


def _approach(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    speed = ca.dot(p["n_W"], model.tool_twist(x)[0]) + p["v_approach"]
    return (p["approach"] * speed,)


def _force(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    moved = contact_motion(model, x, wrench(p), surface(p))
    return (p["rigid"] * (moved.force - p["f_push"]),)


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
        Residual("tool_pose", "tool pose minus desired pose", ("tool",), _POSE, _pose("d"), ("desired",)),
        Residual("twist", "tool twist minus desired twist", ("tool",), _TWIST, _twist("d"), ("desired",)),
        Residual(
            "admittance",
            "tool motion minus the desired motion moved by the virtual mass-spring-damper (ryll2019 (27)), predicted",
            ("tool",),
            (*_POSE, *_TWIST),
            _motion("r"),
            ("admittance",),
        ),
        Residual(
            "thrust",
            "thrust minus the least thrust that holds the target motion against the estimated wrench",
            ("six_axis_wrench",),
            (Term("thrust", "thrust", "1/N^2"),),
            _thrust,
            ("trim",),
        ),
        Residual(
            "tilt",
            "tilt angle minus that of the least thrust that holds the target motion against the estimated wrench",
            ("six_axis_wrench", "tilt"),
            (Term("tilt", "tilt", "1/rad^2"),),
            _tilt,
            ("trim",),
        ),
        Residual("base_pose", "base pose minus that of the desired tool pose", ("tool",), _POSE, _base_pose, ("base",)),
        Residual(
            "impedance",
            "accelerations of the base minus those of the target dynamics of bodie2021 (7)",
            ("tool",),
            (Term("linear", 3, "s^4/m^2"), Term("angular", 3, "s^4/rad^2")),
            _impedance,
            ("base", "contact", "impedance"),
        ),
        Residual(
            "approach",
            "speed along the normal minus that of approach, while a force is wanted and there is no contact",
            ("tool",),
            (Term("approach", 1, "s^2/m^2"),),
            _approach,
            ("contact",),
        ),
        Residual(
            "force",
            "predicted force of the tip on the surface minus the force wanted, while in contact",
            ("tool", "force_torque"),
            (Term("force", 1, "1/N^2"),),
            _force,
            ("contact",),
        ),
        Residual("rate", "thrust rate", (), (Term("rate", "thrust", "s^2/N^2"),), _rate, controls=True),
        Residual(
            "tilt_rate", "tilt rate", ("tilt",), (Term("tilt_rate", "tilt", "s^2/rad^2"),), _tilt_rate, controls=True
        ),
    )
}
