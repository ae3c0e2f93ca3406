"""Lag of rotors and servos under held commands and the limiter that bounds thrusts, angles and their rates."""

import numpy as np
from scipy.integrate import solve_ivp

from aerotact.dynamics.actuators import actuator_limiter, held_command_gain
from aerotact.dynamics.model import Model

RATE = 500.0


def test_held_command_moves_the_actuator_as_the_lag_does(model: Model) -> None:
    start, command = 3.0, 5.0
    gain = held_command_gain(model, 1 / RATE).full().ravel()
    assert gain.shape == model.actuator_time_constants.shape
    for g, tau in zip(gain, model.actuator_time_constants, strict=True):
        lag = solve_ivp(lambda t, T, tau=tau: (command - T) / tau, (0, 1 / RATE), [start], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(start + g * (command - start) / tau, lag.y[0, -1], atol=1e-10)


def test_limiter_keeps_value_and_rate_of_the_actual_actuators(model: Model) -> None:
    rng, n = np.random.default_rng(11), 10_000
    limiter = actuator_limiter(model, RATE)
    wanted = rng.normal(0, 20, size=(model.commands.size, n)) * 10 ** rng.uniform(-1, 3, size=n)
    _, sent = limiter.step.mapaccum(n)(limiter.state.default, wanted, np.zeros((0, n)), np.zeros((0, n)))
    sent = sent.full()
    assert sent.shape == wanted.shape
    assert np.isfinite(sent).all()
    known = {
        "thrust": (model.thrust_limits, model.thrust_rate_limits, model.time_constants),
        "tilt": (model.tilt_limits, model.tilt_rate_limits, model.tilt_time_constants),
    }
    for port in model.actuators:
        (low, high), (slow, fast), tau = known[port.name]
        actual, extremes = np.array(port.default), []
        for command in sent[model.commands.slice(f"{port.name}_cmd")].T:
            rate = (command - actual) / tau
            actual = actual + (1 - np.exp(-1 / RATE / tau)) * (command - actual)
            extremes.append([(actual - high).max(), (low - actual).max(), (rate - fast).max(), (slow - rate).max()])
        assert np.max(extremes) < 1e-9
        assert np.max(extremes, axis=0)[2] > -1e-6, "the bound on the rate must be used up"


def test_limiter_lets_a_feasible_command_through(model: Model) -> None:
    limiter = actuator_limiter(model, RATE)
    wanted = model.commands.default + 0.2
    _, sent = limiter.step(limiter.state.default, wanted, [], [])
    np.testing.assert_array_equal(sent.full().ravel(), wanted)


def test_limiter_knows_the_actuators_as_the_state_does(model: Model) -> None:
    """A problem takes its actuators' values from the limiter's state as it stands."""
    limiter = actuator_limiter(model, RATE)
    assert [(p.name, p.size) for p in limiter.state] == [(p.name, p.size) for p in model.actuators]
    np.testing.assert_array_equal(limiter.state.default, model.hover_state[13:])
