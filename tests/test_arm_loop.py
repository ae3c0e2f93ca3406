"""The loop with arms: sensors of joints at their rates, servo commands, delay, log."""

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from aerotact.codegen.project import block_project
from aerotact.controller import Controller
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.multibody import Multibody
from aerotact.experiments.reference import Hold
from aerotact.flight import controller_project
from aerotact.log import Log
from aerotact.loop import Loop, Wiring
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import BlockBuilder
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[1] / "models"
RATE = 250.0
HEARD = ("servo_measured", "deflection_measured", "passive_measured")


@cache
def _model() -> Multibody:
    return Multibody(load_robot(MODELS / "dual_arm_long_reach"))


@cache
def _controller(with_servos: bool) -> Controller:
    """Thrusts of hover; the left elbow goes 0.2 rad further from the start; passes on what it hears."""
    model = _model()
    b = BlockBuilder("reaching", "example", RATE, "hover, with one elbow on its way")
    sizes = {name: value.shape[0] for name, value in model.sensed(ca.DM(model.hover_state)).items()}
    heard = {n: b.measurement(n, sizes.get(n, model.servos), "rad") for n in HEARD}
    wanted = np.array(model.hover_servo)
    wanted[3] += 0.2
    b.output("thrust_cmd", ca.DM(model.robot.hover_thrust), "N", default=tuple(model.robot.hover_thrust))
    if with_servos:
        b.output("servo_cmd", ca.DM(wanted), "rad", default=tuple(model.hover_servo))
        b.limit_with(actuator_limiter(model, RATE))
    for name, symbol in heard.items():
        b.output(f"heard_{name}", symbol, "rad")
    return Controller(block_project(b.build(), model))


def _fly(seconds: float, with_servos: bool = True, **wiring: object) -> tuple[Log, Loop]:
    model = _model()
    plant = Plant(model.robot)
    estimator = Controller(controller_project("state_estimator", model, RATE))
    loop = Loop(
        plant,
        Sensors(plant, model.robot, 0),
        [estimator],
        _controller(with_servos),
        Wiring(Hold(*model.hover_tool), **wiring),  # type: ignore[arg-type]
    )
    return loop.run(seconds, {}), loop


@pytest.fixture(scope="module")
def flown() -> tuple[Log, Loop]:
    return _fly(0.4)


def test_servo_follows_its_command_and_the_tool_moves(flown: tuple[Log, Loop]) -> None:
    log, _ = flown
    assert log.fault == ""
    assert {n: log.ports[n].unit for n in ("joint", "joint_rate", "servo", "servo_cmd", "p_tools_W")} == {
        "joint": "rad",
        "joint_rate": "rad/s",
        "servo": "rad",
        "servo_cmd": "rad",
        "p_tools_W": "m",
    }
    moved = log["servo"][-1] - _model().hover_servo
    assert moved[3] == pytest.approx(0.2 * -np.expm1(-0.399 / 0.05), abs=1e-3)
    np.testing.assert_allclose(np.delete(moved, 3), 0.0, atol=1e-12)
    left, right = np.abs(log["p_tools_W"][-1] - log["p_tools_W"][0]).reshape(2, 3).max(axis=1)
    assert left > 0.03 > 3 * right


def test_sensors_of_joints_come_at_their_rates(flown: tuple[Log, Loop]) -> None:
    log, loop = flown
    moving = slice(0, 60)
    for name, every in (("deflection_measured", 5), ("passive_measured", 5), ("servo_measured", 20)):
        heard = log[f"{name}_est"][moving]
        changes = np.flatnonzero(np.abs(np.diff(heard, axis=0)).max(axis=1)) + 1
        assert changes.size > 1
        # A controller at 250 Hz hears of a sample at its next step.
        first_heard = {int(np.ceil(k / 4) * 4) for k in range(0, 400, every)}
        assert set(changes.tolist()) <= first_heard
    bias = loop.sensors.joints.biases["deflection_measured"]
    true = log["servo"][:, [0, 3]] - log["joint"][:, [1, 4]]
    np.testing.assert_allclose(log["deflection_measured_est"][300::20], true[300::20] + bias, atol=2e-3)


def test_servo_commands_are_late_by_the_delay() -> None:
    prompt, late = (_fly(0.05, delay=delay)[0]["servo"][:, 3] for delay in (0.0, 3e-3))
    np.testing.assert_allclose(late[3:], prompt[:-3], atol=1e-12)
    assert np.ptp(prompt) > 0.05


def test_arms_hold_under_a_controller_that_says_nothing_of_them() -> None:
    log, _ = _fly(0.1, with_servos=False)
    assert log.fault == ""
    np.testing.assert_allclose(log["servo"], np.tile(_model().hover_servo, (100, 1)), atol=1e-12)
