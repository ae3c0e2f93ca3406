"""Actuators: what a held command does to a lagging rotor or servo, and the limiter that every generated controller ends
with.

An actuator follows its command c with a first-order lag, dT/dt = (c - T)/tau, be T a thrust, a tilt angle or a servo
angle. Held for h seconds, the command moves it by (1 - exp(-h/tau)) (c - T), and the rate is largest at the start:
(c - T)/tau.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model import ActuatorLimits, Model
from aerotact.dynamics.reduced import Reduced
from aerotact.ports import Block, BlockBuilder

TILT = 0.6  # rad, largest of an attitude that is commanded
SPIN = 3.0  # rad/s, largest angular velocity that is commanded, an axis


def held_command_gain(model: Model, period: float) -> Any:
    """Change of tilt and thrust per initial rate over one held command, s, shape (m + n,): tau (1 - exp(-h/tau))."""
    tau = model.actuator_time_constants
    return ca.DM(tau * -np.expm1(-period / tau))


def actuator_limiter(model: Model, rate: float) -> Block:
    """Limiter of thrust, tilt and servo commands at `rate` Hz.

    It carries the actuators' lag as its state, so that it bounds the rate of the actual thrust and angle and not the
    slope of the command: every command that it lets through keeps them, and their rates, within the robot's limits.
    The step's measurement is the command wanted, its output the command to send; both are laid out as model.commands.
    """
    b = BlockBuilder("actuator_limiter", "aerotact", rate, "bounds actual thrusts, angles and their rates")
    actual = {p.name: b.state(p.name, p.size, p.unit, default=p.default) for p in model.actuators}
    for port in model.commands:
        name = port.name.removesuffix("_cmd")
        wanted = b.measurement(port.name, port.size, port.unit, default=port.default)
        command, after = _limited(wanted, actual[name], model.actuator_limits[name], 1.0 / rate)
        b.update(name, after)
        b.output(port.name, command, port.unit, doc=port.doc, default=port.default)
    return b.build()


def _limited(wanted: Any, actual: Any, limits: ActuatorLimits, period: float) -> tuple[Any, Any]:
    """The command within the limits, and what it makes of the actual value in one period."""
    tau = limits.time_constants
    lag = ca.DM(tau)
    command = ca.fmin(ca.fmax(wanted, actual + lag * ca.DM(limits.slowest)), actual + lag * ca.DM(limits.fastest))
    command = ca.fmin(ca.fmax(command, ca.DM(limits.lower)), ca.DM(limits.upper))
    share = ca.DM(tau * -np.expm1(-period / tau)) / lag
    return command, actual + share * (command - actual)


def reference_limiter(model: Reduced, rate: float) -> Block:
    """Limiter, at `rate` Hz, of what a predictive controller sends to an attitude law and to servos.

    Thrust and torque are cut to what all rotors can give together, the tilt of the attitude to TILT and the angular
    velocity to SPIN; servo commands are limited as in `actuator_limiter`.
    """
    b = BlockBuilder("reference_limiter", "aerotact", rate, "bounds references of the attitude law and servo commands")
    actual = {p.name: b.state(p.name, p.size, p.unit, default=p.default) for p in model.actuators}
    wanted = {p.name: b.measurement(p.name, p.size, p.unit, kind=p.kind, default=p.default) for p in model.commands}
    hover, change = ca.DM(model.hover_torque), ca.DM(model.torque_limits)
    lower, upper = model.thrust_limits
    command, after = _limited(wanted["servo_r"], actual["servo"], model.full.actuator_limits["servo"], 1.0 / rate)
    b.update("servo", after)
    values = {
        "lift_r": ca.fmin(ca.fmax(wanted["lift_r"], ca.DM(lower)), ca.DM(upper)),
        "q_WB_r": _upright(wanted["q_WB_r"]),
        "w_B_r": ca.fmin(ca.fmax(wanted["w_B_r"], -SPIN), SPIN),
        "tau_B_r": ca.fmin(ca.fmax(wanted["tau_B_r"], hover - change), hover + change),
        "servo_r": command,
    }
    for port in model.commands:
        b.output(
            port.name,
            values[port.name],
            port.unit,
            frame=port.frame,
            doc=port.doc,
            kind=port.kind,
            default=port.default,
        )
    return b.build()


def _upright(q_WB: Any) -> Any:
    """The attitude with its z axis within TILT of the vertical; level where it has no length."""
    sound = ca.sumsqr(q_WB) > 1e-12
    q = ca.if_else(sound, q_WB / ca.sqrt(ca.fmax(ca.sumsqr(q_WB), 1e-12)), ca.DM([1, 0, 0, 0]))
    # q = tilt * heading about z: the tilt has no z component, and cos(tilt/2) is the length of (w, z)
    length = ca.sqrt(q[0] ** 2 + q[3] ** 2)
    heading = ca.if_else(length > 1e-6, ca.vertcat(q[0], 0, 0, q[3]) / ca.fmax(length, 1e-6), ca.DM([1, 0, 0, 0]))
    tilt = so3.product(q, so3.conjugate(heading))
    across = ca.sqrt(tilt[1] ** 2 + tilt[2] ** 2)
    half = ca.DM(TILT / 2)
    cut = ca.vertcat(ca.cos(half), ca.sin(half) * tilt[1:3] / ca.fmax(across, 1e-6), 0)
    return ca.if_else(across > ca.sin(half), so3.product(cut, heading), q)
