"""Residual blocks of robots whose arms are predicted quasi-statically (`dynamics.reduced`)."""

from collections.abc import Callable
from typing import Any

import casadi as ca

from aerotact.dynamics.model import Model
from aerotact.dynamics.reduced import Reduced
from aerotact.mpc.residuals import Residual, Term, tangential_error

_Build = Callable[[Model, Any, Any, dict[str, Any]], tuple[Any, ...]]
_NEEDS = ("quasi_static",)


def _state(name: str, wanted: str | None = None) -> _Build:
    """A part of the state, less a stage parameter."""

    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        value = model.state.split(x)[name]
        return (value - p[wanted] if wanted else value,)

    return build


def _control(name: str, wanted: str | None = None) -> _Build:
    """A part of the control, less a stage parameter."""

    def build(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
        value = model.control.split(u)[name]
        return (value - p[wanted] if wanted else value,)

    return build


def _reduced(model: Model) -> Reduced:
    assert isinstance(model, Reduced)
    return model


def _base_twist(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    s = model.state.split(x)
    return s["v_WB"] - p["v_WB_d"], s["w_B"]


def _tool_position(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    error = _reduced(model).tool_positions(x) - p["p_tools_d"]
    return (ca.vertcat(tangential_error(p, error[0:3]), error[3:]),)


def _contact_gap(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (p["push"] * (ca.dot(p["n_W"], _reduced(model).tool_positions(x)[0:3]) - p["offset"]),)


def _swing_moment(model: Model, x: Any, u: Any, p: dict[str, Any]) -> tuple[Any, ...]:
    return (_reduced(model).loads(x, p["n_W"])[: _reduced(model).passive],)


ARM_RESIDUALS = {
    r.name: r
    for r in (
        Residual(
            "base_twist",
            "twist of the base minus that wanted",
            _NEEDS,
            (Term("linear", 3, "s^2/m^2"), Term("angular", 3, "s^2/rad^2")),
            _base_twist,
            ("base",),
        ),
        Residual(
            "swing",
            "rates of the passive joints, if there are any",
            _NEEDS,
            (Term("swing", "passive", "s^2/rad^2"),),
            _state("passive_rate"),
        ),
        Residual(
            "swing_moment",
            "moment of gravity and contact about the passive joints, if there are any, at rest",
            _NEEDS,
            (Term("swing_moment", "passive", "1/(N m)^2"),),
            _swing_moment,
        ),
        Residual(
            "posture",
            "joint angles minus those wanted",
            _NEEDS,
            (Term("posture", "joint", "1/rad^2"),),
            _state("joint", "joint_d"),
        ),
        Residual(
            "tool_position",
            "positions of the working arms' tools minus those wanted; of the first in contact only across the normal",
            _NEEDS,
            (Term("tool_position", "tools", "1/m^2"),),
            _tool_position,
        ),
        Residual(
            "contact_force",
            "force of the surface on the tool minus that wanted",
            _NEEDS,
            (Term("contact_force", 1, "1/N^2"),),
            _state("force", "f_push"),
        ),
        Residual(
            "contact_gap",
            "distance of the tool from the surface, in contact",
            _NEEDS,
            (Term("contact_gap", 1, "1/m^2"),),
            _contact_gap,
        ),
        Residual(
            "total_thrust",
            "total thrust minus that which holds the robot",
            _NEEDS,
            (Term("total_thrust", 1, "1/N^2"),),
            _control("thrust", "thrust_trim"),
            controls=True,
        ),
        Residual(
            "torque",
            "torque on the base minus that which holds the robot",
            _NEEDS,
            (Term("torque", 3, "1/(N m)^2"),),
            _control("torque", "torque_trim"),
            controls=True,
        ),
        Residual(
            "joint_rate",
            "rates of the arms' joints",
            _NEEDS,
            (Term("joint_rate", "joint_rate", "s^2/rad^2"),),
            _control("joint_rate"),
            controls=True,
        ),
        Residual(
            "force_rate",
            "rate of the force",
            _NEEDS,
            (Term("force_rate", 1, "s^2/N^2"),),
            _control("force_rate"),
            controls=True,
        ),
    )
}
