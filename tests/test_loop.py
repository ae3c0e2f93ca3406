"""The loop: rates, wiring, delay, truth, bad measurements, a plant that blows up, and equal runs from equal seeds."""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import pytest

from aerotact import loop as loop_module
from aerotact.codegen.project import CProject
from aerotact.controller import Controller
from aerotact.dynamics.model import Model
from aerotact.exceptions import LoopError
from aerotact.experiments.reference import Hold, Waypoints, WithFlags
from aerotact.flight import ESTIMATORS, controller_project
from aerotact.log import Log
from aerotact.loop import Loop, Wiring
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.robot import load_robot

LAW, MPC = "ryll2019_admittance", "tilt_hex_admittance"


@cache
def _model() -> Model:
    return Model(load_robot("tilt_hex"))


@cache
def _project(name: str, rate: float | None) -> CProject:
    return controller_project(name, _model(), rate)


class Watched(Plant):
    """A plant that remembers the commands under which it was stepped."""

    def step(self) -> None:
        self.applied = [*getattr(self, "applied", []), self.data.ctrl.copy()]
        super().step()


class Deaf(Sensors):
    """Sensors of which one signal is NaN for a while."""

    signal, start, stop = "", 0.0, 0.0

    def _spoil(self, sample: dict[str, Array]) -> dict[str, Array]:
        if self.start <= self._plant.time < self.stop and self.signal in sample:
            sample[self.signal] = np.full_like(sample[self.signal], np.nan)
        return sample

    def imu(self) -> dict[str, Array]:
        return self._spoil(super().imu())

    def motion_capture(self) -> dict[str, Array]:
        return self._spoil(super().motion_capture())

    def rotor_speed(self) -> dict[str, Array]:
        return self._spoil(super().rotor_speed())


def _hold() -> Reference:
    return WithFlags(Hold(*_model().hover_tool), {"calibrate": (0.1, 0.2)})


def _make(
    name: str = LAW,
    rate: float | None = 500.0,
    seed: int = 0,
    estimators: tuple[str, ...] = ESTIMATORS,
    estimator_rate: float = 500.0,
    timestep: float = 1e-3,
    sensors: Callable[[Plant, int], Sensors] | None = None,
    **wiring: object,
) -> Loop:
    plant = Watched(_model().robot, timestep=timestep)
    chain = [Controller(_project(e, estimator_rate)) for e in estimators]
    sensed = sensors(plant, seed) if sensors else Sensors(plant, plant.robot, seed)
    controller = Controller(_project(name, rate))
    return Loop(plant, sensed, chain, controller, Wiring(**{"reference": _hold(), **wiring}))  # type: ignore[arg-type]


def _tilt(log: Log) -> Array:
    """Angle of the base from level, rad."""
    return 2 * np.linalg.norm(log["q_WB"][:, 1:3], axis=1)


def test_rates_must_divide() -> None:
    with pytest.raises(LoopError, match=r"ryll2019_admittance runs at 300 Hz; valid: 1000 Hz divided"):
        _make(rate=300.0)
    with pytest.raises(LoopError, match=r"the IMU runs at 500 Hz; valid: 250 Hz divided"):
        _make(timestep=4e-3)
    with pytest.raises(LoopError, match=r"state_estimator runs at 250 Hz; valid: 500 Hz"):
        _make(estimator_rate=250.0)


def test_measurement_that_nothing_serves_is_named() -> None:
    with pytest.raises(LoopError, match=r"nothing serves f_ext_W.* of ryll2019_admittance; there is: .*p_WB"):
        _make(estimators=("state_estimator",))


def test_reference_that_nothing_serves_is_named() -> None:
    with pytest.raises(LoopError, match=r"nothing serves the reference calibrate of wrench_observer"):
        _make(reference=Hold(*_model().hover_tool)).run(0.01, {})


def test_block_without_a_command_cannot_fly() -> None:
    with pytest.raises(LoopError, match=r"ryll2019_admittance_filter .*cannot fly; valid: .*thrust_cmd"):
        _make("ryll2019_admittance_filter")


@pytest.mark.parametrize(("name", "rate"), [(LAW, 500.0), (MPC, None)])
@pytest.mark.parametrize("steps", [0, 1, 7, 23])
def test_delay_is_of_exactly_so_many_steps(name: str, rate: float | None, steps: int) -> None:
    loop = _make(name, rate, delay=steps * 1e-3)
    log = loop.run(0.1, {})
    applied, said = np.array(loop.plant.applied), log["thrust_cmd"]
    np.testing.assert_array_equal(applied[steps:], said[: len(said) - steps])
    np.testing.assert_array_equal(applied[:steps], np.tile(_model().robot.hover_thrust, (steps, 1)))
    assert np.ptp(said, axis=0).max() > 1e-3


def test_measured_delay_is_the_time_of_the_step_rounded_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter(np.arange(10000) * 2.5e-3)
    monkeypatch.setattr(loop_module.clock, "perf_counter", lambda: float(next(now)))
    loop = _make(delay="measured")
    log = loop.run(0.1, {})
    np.testing.assert_allclose(log.solve_times, 2.5e-3)
    np.testing.assert_array_equal(np.array(loop.plant.applied)[3:], log["thrust_cmd"][:-3])


def test_controller_gets_estimates_unless_the_truth_is_asked_for() -> None:
    estimated, true = _make().run(0.3, {}), _make(truth=True).run(0.3, {})
    for signal in ("p_WB", "q_WB", "v_WB", "w_B"):
        rows = true.stepped(slice(0, 300))
        np.testing.assert_array_equal(true[f"{signal}_est"][rows], true[signal][rows])
        assert np.abs(estimated[f"{signal}_est"] - estimated[signal])[100:].max() > 1e-6


def test_rows_hold_what_a_slow_controller_said_but_not_what_is_wanted() -> None:
    tour = Waypoints(*_model().hover_tool, [0.0, 0.2], np.array([[0, 0, 0], [0.02, 0, 0]]), np.zeros((2, 3)))
    reference = WithFlags(tour, {"calibrate": (0.0, 0.1)})
    log = _make(MPC, None, reference=reference).run(0.2, {})
    assert log.every == 10
    for signal in ("thrust_cmd", "p_WE_r", "p_WB_est", "f_tool_W_est"):
        blocks = log[signal].reshape(20, 10, -1)
        np.testing.assert_array_equal(blocks, np.repeat(blocks[:, :1], 10, axis=1))
        assert np.unique(blocks[:, 0], axis=0).shape[0] == 20
    np.testing.assert_array_equal(log["p_WE_d"], tour.sample(log.time)["p_WE_d"])
    assert not np.isnan(np.hstack(list(log.columns.values()))).any()
    np.testing.assert_allclose(log.time, np.arange(200) * 1e-3, atol=1e-15)


def test_log_knows_units_of_all_columns() -> None:
    log = _make().run(0.01, {"experiment": "none"})
    assert set(log.ports) == set(log.columns)
    assert log.ports["q_WE"].labels == ("w", "x", "y", "z")
    assert (log.ports["thrust_rate"].unit, log.ports["v_WB_est"].unit, log.ports["p_WE_d"].frame) == ("N/s", "m/s", "W")
    assert log.head == {"experiment": "none"}


@pytest.mark.parametrize(("name", "rate"), [(LAW, 500.0), (MPC, None)])
@pytest.mark.parametrize("signal", ["accelerometer_B", "gyro_B", "mocap_p_WB", "mocap_q_WB", "thrust_measured"])
def test_flight_recovers_from_nan_in_a_sensor(name: str, rate: float | None, signal: str) -> None:
    def deaf(plant: Plant, seed: int) -> Sensors:
        sensors = Deaf(plant, plant.robot, seed)
        sensors.signal, sensors.start, sensors.stop = signal, 0.5, 0.55
        return sensors

    log = _make(name, rate, sensors=deaf).run(1.5, {})
    assert log.fault == ""
    assert len(log.time) == 1500
    # 50 ms are 25 samples of the IMU and of the rotors.
    block = "wrench_observer" if signal == "thrust_measured" else "state_estimator"
    bad = log.estimator_statuses[block]["BAD_INPUT"]
    assert bad == 25
    assert log.estimator_statuses[block]["OK"] == 750 - bad
    assert np.isfinite(log["thrust_cmd"]).all()
    home = log["p_WB"][400]
    assert np.linalg.norm(log["p_WB"] - home, axis=1)[1400:].max() < 0.02
    assert _tilt(log).max() < 0.1
    assert log.statuses == {"OK": 750 if name == LAW else 150}


@pytest.mark.parametrize(("name", "rate"), [(LAW, 500.0), (MPC, None)])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_reference_is_counted_and_the_flight_goes_on(name: str, rate: float | None, bad: float) -> None:
    class Spoilt:
        def sample(self, times: Array) -> Mapping[str, Array]:
            wanted = dict(_hold().sample(times))
            wrong = ((times >= 0.5) & (times < 0.53))[:, None]
            return wanted | {"p_WE_d": np.where(wrong, bad, wanted["p_WE_d"])}

    log = _make(name, rate, reference=Spoilt()).run(1.2, {})
    assert log.fault == ""
    assert log.statuses["BAD_INPUT"] >= 3
    assert set(log.statuses) == {"OK", "BAD_INPUT"}
    assert log["thrust_cmd"].min() > 0.25
    assert np.linalg.norm(log["p_WB"] - log["p_WB"][400], axis=1)[1100:].max() < 0.02


def test_plant_that_blows_up_keeps_its_log() -> None:
    class Blow:
        def begin(self, plant: Plant) -> None: ...

        def apply(self, plant: Plant) -> None:
            if plant.time > 0.2995:
                plant.push(plant.base_id, np.full(3, 1e14), np.zeros(3))

    loop = _make()
    loop.plant.disturb(Blow())
    log = loop.run(1.0, {"seed": 0})
    assert "plant stopped at 0.30" in log.fault
    assert len(log.time) == 300
    assert all(len(values) == 300 for values in log.columns.values())
    assert log.statuses == {"OK": 151}
    assert len(log.solve_times) == 151


def test_interruption_keeps_the_log() -> None:
    def stop(time: float) -> None:
        if time > 0.4:
            raise KeyboardInterrupt

    log = _make().run(2.0, {}, stop)
    assert log.fault == "interrupted"
    assert len(log.time) == 501


@pytest.mark.parametrize(("name", "rate"), [(LAW, 500.0), (MPC, None)])
def test_equal_seeds_give_equal_bytes(name: str, rate: float | None) -> None:
    first, again, other = (_make(name, rate, seed=seed).run(0.4, {}) for seed in (4, 4, 5))
    for signal, values in first.columns.items():
        assert values.tobytes() == again[signal].tobytes(), signal
    assert not np.array_equal(first["thrust"], other["thrust"])
