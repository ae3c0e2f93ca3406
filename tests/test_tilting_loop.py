"""The loop with tilting rotors: what is commanded, measured, logged and estimated."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from holding import hold

from aerotact.codegen.project import block_project
from aerotact.controller import Controller
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.exceptions import InputError, LoopError
from aerotact.experiments.reference import Hold, WithFlags
from aerotact.flight import ESTIMATORS, controller_project
from aerotact.log import Log
from aerotact.loop import Loop, Wiring
from aerotact.metrics import standard_metrics
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.plant.mismatch import TiltError
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array, BlockBuilder
from aerotact.robot import load_robot


@cache
def _model() -> Model:
    return Model(load_robot("tilt_rotor"))


class Watched(Plant):
    """A plant that remembers what was commanded before each step."""

    def command(self, thrust: Array, tilt: Array | None = None) -> None:
        self.last = tilt
        super().command(thrust, tilt)

    def step(self) -> None:
        self.commanded = [*getattr(self, "commanded", []), getattr(self, "last", np.zeros(6)).copy()]
        super().step()


def _run(seconds: float, disturbances: list[Disturbance], seed: int = 0, **wiring: object) -> tuple[Log, Loop]:
    model = _model()
    plant = Watched(model.robot, disturbances=disturbances, seed=seed)
    chain = [Controller(controller_project(name, model, 500.0)) for name in ESTIMATORS]
    controller = Controller(block_project(hold(model, 500.0), model))
    reference = WithFlags(Hold(*model.hover_tool), {"calibrate": (0.2, 0.8)})
    loop = Loop(plant, Sensors(plant, model.robot, seed), chain, controller, Wiring(reference, **wiring))  # type: ignore[arg-type]
    return loop.run(seconds, {}), loop


@pytest.fixture(scope="module")
def pulled() -> Log:
    """Pulled sideways at the tool by a force that is off the centre of mass."""
    log, _ = _run(6.0, [ToolForce((2.0, 3.0, -1.0), 1.0, 6.0, ramp=0.2)])
    return log


def test_robot_holds_against_a_pull(pulled: Log) -> None:
    assert pulled.fault == ""
    assert pulled.statuses == {"OK": 3000}
    np.testing.assert_allclose(pulled["p_WB"][-1], [0.0, 0.0, 1.5], atol=0.02)
    assert np.abs(pulled["q_WB"][-1, 1:]).max() < 0.02
    assert np.abs(pulled["tilt"][-1]).max() > 0.05
    metrics = standard_metrics(pulled, _model().robot)
    for name in ("thrust", "thrust_rate", "tilt", "tilt_rate"):
        assert metrics[f"violations_{name}"].value == 0


def test_observer_uses_the_tilts(pulled: Log) -> None:
    """The force is found although half of it is balanced by tilted thrust, which fixed rotors could not explain."""
    late = slice(4000, 6000)
    estimate = pulled["f_ext_W_est"][late].mean(axis=0)
    np.testing.assert_allclose(estimate, [2.0, 3.0, -1.0], atol=0.35)  # the accelerometer's bias times the mass
    torque = np.cross(_model().robot.p_BE - _model().robot.p_BC, [2.0, 3.0, -1.0])
    np.testing.assert_allclose(pulled["tau_ext_B_est"][late].mean(axis=0), torque, atol=0.05)


def test_log_has_what_was_commanded_and_what_came_of_it(pulled: Log) -> None:
    units = {name: pulled.ports[name].unit for name in ("tilt", "tilt_rate", "tilt_rate_cmd", "tilt_cmd")}
    assert units == {"tilt": "rad", "tilt_rate": "rad/s", "tilt_rate_cmd": "rad/s", "tilt_cmd": "rad"}
    tau = _model().tilt_time_constants
    # What the limiter takes for the angle is the plant's shaft: the demanded rate is the command's distance over tau.
    modelled = pulled["tilt_cmd"][:-1] - tau * pulled["tilt_rate_cmd"][1:]
    np.testing.assert_allclose(modelled, pulled["tilt"][:-1], atol=0.02)


@pytest.mark.parametrize("steps", [0, 3])
def test_tilts_are_late_by_the_delay(steps: int) -> None:
    log, loop = _run(0.3, [], delay=steps * 1e-3)
    applied = np.array(loop.plant.commanded)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(applied[steps:], log["tilt_cmd"][: len(applied) - steps])
    assert np.ptp(log["tilt_cmd"], axis=0).max() > 1e-4


def test_misaligned_rotors_are_a_wrench_to_the_observer() -> None:
    log, _ = _run(4.0, [TiltError(np.deg2rad(1.0))])
    assert log.fault == ""
    np.testing.assert_allclose(log["p_WB"][-1], [0.0, 0.0, 1.5], atol=0.02)
    torque = -6 * 0.3 * _model().robot.hover_thrust[0] * np.sin(np.deg2rad(1.0))
    assert log["tau_ext_B_est"][3000:, 2].mean() == pytest.approx(torque, rel=0.1)


def test_force_sensor_is_served_at_its_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    model, calls = _model(), []
    plain = Sensors.force_torque
    monkeypatch.setattr(Sensors, "force_torque", lambda self: (calls.append(self._plant.time), plain(self))[1])
    plant = Plant(model.robot)
    b = BlockBuilder("feels", "example", 500.0, "hover, and passes on what the sensor feels")
    force = b.measurement("f_sensor_S", 3, "N")
    for port in model.commands:
        b.output(port.name, ca.DM(port.default), port.unit, default=port.default)
    b.output("heard_S", force, "N")
    controller = Controller(block_project(b.build(), model))
    loop = Loop(plant, Sensors(plant, model.robot, 0), [], controller, Wiring(Hold(*model.hover_tool)))
    calls.clear()
    log = loop.run(0.1, {})
    np.testing.assert_allclose(calls, np.arange(50) * 2e-3, atol=1e-12)
    # The weight is held upwards, which is -x of S; 20 ms of drift and the mean of 50 noises are small.
    held = log["heard_S"].mean(axis=0) - loop.sensors.biases["f_sensor_S"]
    np.testing.assert_allclose(held, [-0.03 * 9.81, 0.0, 0.0], atol=0.03)


def test_controller_without_tilts_cannot_fly_and_is_not_built() -> None:
    model = _model()
    b = BlockBuilder("upright", "example", 500.0, "thrust alone")
    b.measurement("p_WB", 3, "m")
    b.output("thrust_cmd", ca.DM(model.robot.hover_thrust), "N")
    plant = Plant(model.robot)
    controller = Controller(controller_project("wrench_observer", model, 500.0))
    with pytest.raises(LoopError):
        Loop(plant, Sensors(plant, model.robot, 0), [], controller, Wiring(Hold(*model.hover_tool)))
    b.limit_with(actuator_limiter(model, 500.0))
    with pytest.raises(InputError, match=r"block upright: first outputs are .*valid: .*tilt_cmd"):
        b.build()
