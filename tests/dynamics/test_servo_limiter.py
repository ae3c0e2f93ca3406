"""The actuator limiter of a robot with arms: thrusts and servo angles keep their ranges and rates."""

from pathlib import Path

import numpy as np
import pytest

from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
RATE = 50.0


@pytest.fixture(scope="module")
def arms() -> Model:
    return model_of(load_robot(MODELS / "dual_arm_long_reach"))


def test_limits_are_the_robots(arms: Model) -> None:
    servo = arms.actuator_limits["servo"]
    np.testing.assert_allclose(np.rad2deg(servo.lower), [-90, -10, -90, -135] * 2)
    np.testing.assert_allclose(np.rad2deg(servo.upper), [90, 90, 90, 135] * 2)
    np.testing.assert_array_equal(servo.fastest, [7.1, 7.1, 6.3, 7.1] * 2)
    np.testing.assert_array_equal(servo.slowest, -servo.fastest)
    assert list(arms.actuator_limits) == ["thrust", "servo"]


def test_whatever_is_wanted_the_actual_values_stay_within_limits(arms: Model) -> None:
    rng, n = np.random.default_rng(12), 3000
    limiter = actuator_limiter(arms, RATE)
    wanted = rng.normal(0, 3, size=(arms.commands.size, n)) * 10 ** rng.uniform(-1, 3, size=n)
    _, sent = limiter.step.mapaccum(n)(limiter.state.default, wanted, np.zeros((0, n)), np.zeros((0, n)))
    for port in arms.actuators:
        limits, actual, used = arms.actuator_limits[port.name], np.array(port.default), 0.0
        for command in sent.full()[arms.commands.slice(f"{port.name}_cmd")].T:
            rate = (command - actual) / limits.time_constants
            assert ((rate > limits.slowest - 1e-9) & (rate < limits.fastest + 1e-9)).all()
            used = max(used, float((rate / limits.fastest).max()))
            actual = actual - np.expm1(-1 / RATE / limits.time_constants) * (command - actual)
            assert ((actual > limits.lower - 1e-9) & (actual < limits.upper + 1e-9)).all()
        assert used > 0.999


def test_hover_passes(arms: Model) -> None:
    limiter = actuator_limiter(arms, RATE)
    _, sent = limiter.step(limiter.state.default, arms.commands.default, [], [])
    np.testing.assert_array_equal(sent.full().ravel(), arms.commands.default)
