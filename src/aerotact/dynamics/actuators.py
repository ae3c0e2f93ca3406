"""Actuators: what a held command does to a lagging rotor, and the limiter that every generated controller ends with.

A rotor follows its command c with a first-order lag, dT/dt = (c - T)/tau. Held for h seconds, the command moves the
thrust by (1 - exp(-h/tau)) (c - T), and the rate is largest at the start: (c - T)/tau.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.model import Model
from aerotact.ports import Block, BlockBuilder


def held_command_gain(model: Model, period: float) -> Any:
    """Thrust change per initial rate over one held command, s, shape (n,): tau (1 - exp(-h/tau))."""
    tau = model.time_constants
    return ca.DM(tau * -np.expm1(-period / tau))


def thrust_limiter(model: Model, rate: float) -> Block:
    """Limiter of thrust commands at `rate` Hz.

    It carries the rotors' lag as its state, so that it bounds the rate of the actual thrust and not the slope of the
    command: every command that it lets through keeps thrust, and the rate of thrust, within the robot's limits.
    The step's measurement is the command wanted, its output the command to send; both are `thrust_cmd`, N.
    """
    b = BlockBuilder("thrust_limiter", "aerotact", rate, "bounds thrust and thrust rate of the actual rotor")
    lower, upper = (ca.DM(v) for v in model.thrust_limits)
    rate_lower, rate_upper = (ca.DM(v) for v in model.thrust_rate_limits)
    tau = ca.DM(model.time_constants)
    hover = tuple(model.robot.hover_thrust)
    thrust = b.state("thrust", model.rotors, "N", default=hover)
    wanted = b.measurement("thrust_cmd", model.rotors, "N", default=hover)
    command = ca.fmin(ca.fmax(wanted, thrust + tau * rate_lower), thrust + tau * rate_upper)
    command = ca.fmin(ca.fmax(command, lower), upper)
    gain = held_command_gain(model, 1.0 / rate) / tau
    b.update("thrust", thrust + gain * (command - thrust))
    b.output("thrust_cmd", command, "N", doc="thrust commands", default=hover)
    return b.build()
