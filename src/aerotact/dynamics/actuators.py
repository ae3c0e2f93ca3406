"""Actuators: what a held command does to a lagging rotor or servo, and the limiter that every generated controller ends
with.

An actuator follows its command c with a first-order lag, dT/dt = (c - T)/tau, be T a thrust, a tilt angle or a servo
angle. Held for h seconds, the command moves it by (1 - exp(-h/tau)) (c - T), and the rate is largest at the start:
(c - T)/tau.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.model import ActuatorLimits, Model
from aerotact.ports import Block, BlockBuilder


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
