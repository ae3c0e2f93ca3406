"""Rotor lag under held commands and the limiter that bounds thrust and its rate."""

import numpy as np
from scipy.integrate import solve_ivp

from aerotact.dynamics.actuators import actuator_limiter, held_command_gain
from aerotact.dynamics.model import Model

RATE = 500.0


def test_held_command_moves_the_thrust_as_the_lag_does(model: Model) -> None:
    thrust, command, tau = 3.0, 5.0, model.time_constants[0]
    lag = solve_ivp(lambda t, T: (command - T) / tau, (0, 1 / RATE), [thrust], rtol=1e-12, atol=1e-12)
    rate = (command - thrust) / tau
    gain = held_command_gain(model, 1 / RATE).full().ravel()
    np.testing.assert_allclose(thrust + gain[0] * rate, lag.y[0, -1], atol=1e-10)


def test_limiter_keeps_thrust_and_rate_of_the_actual_rotor(model: Model) -> None:
    rng, n = np.random.default_rng(11), 10_000
    limiter = actuator_limiter(model, RATE)
    wanted = rng.normal(0, 20, size=(model.rotors, n)) * 10 ** rng.uniform(-1, 3, size=n)
    _, sent = limiter.step.mapaccum(n)(limiter.state.default, wanted, np.zeros((0, n)), np.zeros((0, n)))
    sent = sent.full()
    assert sent.shape == wanted.shape
    assert np.isfinite(sent).all()
    (low, high), (slow, fast) = model.thrust_limits, model.thrust_rate_limits
    thrust, tau = model.robot.hover_thrust.copy(), model.time_constants
    extremes = []
    for command in sent.T:
        rate = (command - thrust) / tau
        thrust = thrust + (1 - np.exp(-1 / RATE / tau)) * (command - thrust)
        extremes.append([(thrust - high).max(), (low - thrust).max(), (rate - fast).max(), (slow - rate).max()])
    assert np.max(extremes) < 1e-9
    assert np.max(extremes, axis=0)[2] > -1e-6, "the bound on the rate must be used up"


def test_limiter_lets_a_feasible_command_through(model: Model) -> None:
    limiter = actuator_limiter(model, RATE)
    wanted = model.robot.hover_thrust + 0.5
    _, sent = limiter.step(limiter.state.default, wanted, [], [])
    np.testing.assert_array_equal(sent.full().ravel(), wanted)
