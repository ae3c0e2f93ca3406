"""Compliant-joint control: torque or link position through the servo's angle, (14)-(22).

Angles are rad, torques N m; everything takes CasADi expressions or numbers, columns of any number of joints.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.ports import BlockBuilder


@dataclass(frozen=True)
class LoopGains:
    """Gains of (19) or (21), one number each: rad per unit of the error, and the same a second.

    Attributes:
        p: proportional.
        i: integral.
        most: largest angle that the integral may ask, rad.
    """

    p: Any
    i: Any
    most: Any


def add_loop_gains(b: BlockBuilder, name: str, unit: str, p: float, i: float, most: float) -> LoopGains:
    """Parameters <name>_p, <name>_i, <name>_most; the paper gives no values.

    Args:
        b: takes the parameters.
        name: "torque", (19), or "position", (21).
        unit: of the proportional gain.
        p, i, most: defaults.
    """
    per_second = "1/s" if unit == "1" else f"{unit[:-1]} s)"
    return LoopGains(
        p=b.parameter(f"{name}_p", 1, unit, p, doc=f"K_p of the {name} controller", lower=0.0),
        i=b.parameter(f"{name}_i", 1, per_second, i, doc=f"K_I of the {name} controller", lower=0.0),
        most=b.parameter(f"{name}_most", 1, "rad", most, doc=f"largest angle of the {name}'s integral", lower=0.0),
    )


def deflection(theta: Any, q: Any) -> Any:
    """Angle of the spring, (14): servo shaft minus output link."""
    return theta - q


def spring_torque(stiffness: Any, damping: Any, angle: Any, rate: Any) -> Any:
    """Torque of the spring on the link, (15), for its deflection and the rate of that."""
    return stiffness * angle + damping * rate


def lever_stiffness(spring: Any, lever: Any) -> Any:
    """Torsional stiffness, N m/rad, of springs of `spring` N/m at a lever of `lever` m, (16)."""
    return spring * lever**2


def position_error(q_ref: Any, theta: Any, angle: Any) -> Any:
    """Error of the link, (20), from the servo's angle and the measured deflection."""
    return q_ref - (theta - angle)


def correction(gains: LoopGains, error: Any, integral: Any) -> Any:
    """Correction angle of an error, the torque's (18) or the position's (20), and its integral: (19), (21)."""
    return gains.p * error + gains.i * integral


def servo_reference(theta: Any, position: Any, torque: Any, by_position: Any) -> Any:
    """Servo angle to command, (22): the present one and one of the corrections; by_position is delta, 1 or 0."""
    return theta + by_position * position + (1 - by_position) * torque


def next_integral(gains: LoopGains, integral: Any, error: Any, on: Any, period: float) -> Any:
    """Integral of an error one period later, so bounded that it asks no more than `most`; 0 while off."""
    bound = gains.most / ca.fmax(gains.i, 1e-9)
    return ca.if_else(on, ca.fmin(ca.fmax(integral + period * error, -bound), bound), 0)
