"""Compliant-joint control: torque or link position through the servo's angle, (14)-(22).

Angles are rad, torques N m; everything takes CasADi expressions or numbers, columns of any number of joints.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.ports import BlockBuilder


@dataclass(frozen=True)
class JointGains:
    """Gains of (19) and (21), one number each.

    Attributes:
        torque_p: K_p of the torque controller, rad/(N m).
        torque_i: K_I of the torque controller, rad/(N m s).
        position_p: K_p of the position controller, 1.
        position_i: K_I of the position controller, 1/s.
        correction_max: largest angle that an integral may ask, rad.
    """

    torque_p: Any
    torque_i: Any
    position_p: Any
    position_i: Any
    correction_max: Any


def add_joint_gains(b: BlockBuilder) -> JointGains:
    """Parameters; the paper gives no values."""

    def gain(name: str, unit: str, default: float, doc: str) -> Any:
        return b.parameter(name, 1, unit, default, doc=doc, lower=0.0)

    return JointGains(
        torque_p=gain("torque_p", "rad/(N m)", 0.2, "K_p of the torque controller, (19)"),
        torque_i=gain("torque_i", "rad/(N m s)", 0.2, "K_I of the torque controller, (19)"),
        position_p=gain("position_p", "1", 0.2, "K_p of the position controller, (21)"),
        position_i=gain("position_i", "1/s", 0.2, "K_I of the position controller, (21)"),
        correction_max=gain("correction_max", "rad", 0.2, "largest angle of an integral in (19) and (21)"),
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


def torque_correction(gains: JointGains, error: Any, integral: Any) -> Any:
    """Correction angle of the torque error (18) and its integral, N m s: (19)."""
    return gains.torque_p * error + gains.torque_i * integral


def position_error(q_ref: Any, theta: Any, angle: Any) -> Any:
    """Error of the link, (20), from the servo's angle and the measured deflection."""
    return q_ref - (theta - angle)


def position_correction(gains: JointGains, error: Any, integral: Any) -> Any:
    """Correction angle of the position error (20) and its integral, rad s: (21)."""
    return gains.position_p * error + gains.position_i * integral


def servo_reference(theta: Any, position: Any, torque: Any, by_position: Any) -> Any:
    """Servo angle to command, (22): the present one and one of the corrections; by_position is delta, 1 or 0."""
    return theta + by_position * position + (1 - by_position) * torque


def next_integral(integral: Any, error: Any, gain: Any, most: Any, on: Any, period: float) -> Any:
    """Integral of an error one period later: 0 while off, its correction at most `most` rad."""
    bound = most / ca.fmax(gain, 1e-9)
    return ca.if_else(on, ca.fmin(ca.fmax(integral + period * error, -bound), bound), 0)
