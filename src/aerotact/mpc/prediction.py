"""Prediction: the equations of motion that an OCP believes in, given a stage's parameters."""

from itertools import pairwise
from typing import Any

import casadi as ca

from aerotact.dynamics.contact import Surface, contact_motion
from aerotact.dynamics.model import Model
from aerotact.dynamics.reduced import Arms, Reduced


def surface(p: dict[str, Any]) -> Surface:
    """The surface that a stage's parameters tell of."""
    return Surface(p["n_W"], p["offset"], p["friction_W"], p["stiffness"], p["damping"], p["rigid"])


def wrench(p: dict[str, Any]) -> Any:
    """The wrench on the robot besides that of a predicted contact, (6,)."""
    return ca.vertcat(p["f_ext_W"], p["tau_ext_B"])


def parameter(p: dict[str, Any]) -> Any:
    """The parameter of a reduced predictor that a stage's parameters tell of, (9,)."""
    return ca.vertcat(wrench(p), p["n_W"])


def accelerations(model: Model, x: Any, p: dict[str, Any]) -> tuple[Any, Any]:
    """a_WB, m/s2 in W, and dw_B, rad/s2 in B, with the contact if the stage knows of a surface."""
    if "n_W" not in p:
        return model.accelerations(x, wrench(p))
    moved = contact_motion(model, x, wrench(p), surface(p))
    return moved.a_WB, moved.dw_B


def derivative(model: Model, x: Any, u: Any, p: dict[str, Any], arms: Arms | None = None) -> Any:
    """dx/dt for the rates u of the actuators, or the controls u of a reduced predictor with its arms held as given."""
    if isinstance(model, Reduced):
        return model.derivative(x, u, parameter(p), arms)
    return model.state_rate(x, u, *accelerations(model, x, p))


def ahead(model: Model, x: Any, actuators: list[Any], period: float, p: dict[str, Any]) -> Any:
    """State after the actuators have gone through the values given, one period after the other.

    Args:
        model: of the robot.
        x: pose and twist now, (13,).
        actuators: their values now and after each period; between them they move linearly.
        period: s.
        p: stage parameters.
    """
    for now, then in pairwise(actuators):
        rate, whole = (then - now) / period, ca.vertcat(x, now)
        k1 = derivative(model, whole, rate, p)
        k2 = derivative(model, whole + period / 2 * k1, rate, p)
        k3 = derivative(model, whole + period / 2 * k2, rate, p)
        k4 = derivative(model, whole + period * k3, rate, p)
        x = (whole + period / 6 * (k1 + 2 * k2 + 2 * k3 + k4))[0:13]
    return ca.vertcat(x[0:3], x[3:7] / ca.norm_2(x[3:7]), x[7:13], actuators[-1])
