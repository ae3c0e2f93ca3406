"""Loop: plant, sensors, estimators and controllers, each at its own rate by the plant's clock, wired by port names.

Controllers may be nested: the outputs of an outer one are the inner one's references, by name, and the innermost
commands the plant.
"""

import time as clock
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from aerotact.controller import Controller, Status
from aerotact.exceptions import AerotactError, LoopError
from aerotact.log import Log
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.recorder import Recorder
from aerotact.reference import LiveReference, Operator, Reference, ReferenceTable
from aerotact.sight import Sight

COMMANDS = {"thrust_cmd": "thrust", "tilt_cmd": "tilt", "servo_cmd": "servo"}  # port -> argument of Plant.command
STATE_SIGNALS = ("p_WB", "q_WB", "v_WB", "w_B")
WATCH_EVERY = 500  # physics steps
LOST = 20.0  # m from the start; no experiment goes so far


@dataclass(frozen=True)
class Wiring:
    """How a loop is closed.

    Attributes:
        truth: the controllers get the true state of the base instead of the estimate.
        delay: s from measurement to command, or to the inner controller's reference: a number, or "measured" for the
            controller's own computing time.
        reference: what is wanted.
    """

    reference: Reference
    truth: bool = False
    delay: float | Literal["measured"] = 0.0


class Loop:
    """One closed loop, ready to run once."""

    def __init__(
        self,
        plant: Plant,
        sensors: Sensors,
        estimators: Sequence[Controller],
        controller: Controller | Sequence[Controller],
        wiring: Wiring,
    ) -> None:
        """Wire it.

        Args:
            plant: what is flown.
            sensors: of the plant.
            estimators: in the order of the calls.
            controller: one, or nested ones from the outermost to the innermost.
            wiring: of them all.

        Raises:
            LoopError: a rate that is no fraction of the physics' rate, a measurement that nothing serves, an outer
                controller that gives the inner one nothing, or no command.
        """
        self.plant, self.sensors, self.wiring = plant, sensors, wiring
        self.controllers = [controller] if isinstance(controller, Controller) else list(controller)
        self.controller = self.controllers[0]
        self.estimators = list(estimators)
        self._imu_every = self._every(sensors.imu_rate, "the IMU")
        self._mocap_every = self._every(sensors.mocap_rate, "motion capture")
        self._force_every = self._every(sensors.force_torque_rate or sensors.imu_rate, "the force/torque sensor")
        if self._force_every % self._imu_every:
            raise LoopError(
                f"the force/torque sensor runs at {sensors.force_torque_rate:g} Hz; "
                f"valid: {sensors.imu_rate:g} Hz, the IMU's, divided by a whole number"
            )
        self._joints_every = {name: self._every(rate, name) for name, rate in sensors.joints.rates.items()}
        self._control_every = [self._every(c.rate, c.name) for c in self.controllers]
        self._handed = [_handed(outer, inner) for outer, inner in pairwise(self.controllers)]
        for estimator in self.estimators:
            if self._every(estimator.rate, estimator.name) != self._imu_every:
                raise LoopError(
                    f"{estimator.name} runs at {estimator.rate:g} Hz; valid: {sensors.imu_rate:g} Hz, the IMU's"
                )
        self._bus: dict[str, Array] = {
            **sensors.imu(),
            **sensors.motion_capture(),
            **sensors.rotor_speed(),
            **sensors.tilt_encoder(),
            **sensors.force_torque(),
            **sensors.joints.samples(),
            "mocap_fresh": np.zeros(1),
        }
        self._sight = Sight(plant, sensors.depth_camera) if sensors.depth_camera else None
        if self._sight:
            self._bus.update(self._sight.patch())
            if wiring.truth:
                self._bus.update(self._sight.truth())
            self._frame_every = self._every(self._sight.rate, "the depth camera")
            if self._frame_every % self._imu_every:
                imu = f"{sensors.imu_rate:g} Hz, the IMU's, divided by a whole number"
                raise LoopError(f"the depth camera runs at {self._sight.rate:g} Hz; valid: {imu}")
        for block in (*self.estimators, *self.controllers):
            missing = [name for name in block.measurement if name not in self._bus]
            if missing:
                raise LoopError(
                    f"nothing serves {', '.join(missing)} of {block.name}; there is: {', '.join(self._bus)}"
                )
            self._bus.update({name: value.copy() for name, value in block.output.items()})
        needed, innermost = ("thrust_cmd", "tilt_cmd") if plant.robot.tilts else ("thrust_cmd",), self.controllers[-1]
        if any(name not in innermost.output for name in needed):
            raise LoopError(
                f"{innermost.name} gives {', '.join(innermost.output)} and cannot fly; "
                f"valid: what gives {' and '.join(needed)}"
            )
        # Arms hold the angles of hover under a controller that says nothing of them.
        self._commands = [n for n in COMMANDS if n in needed or (n == "servo_cmd" and n in innermost.output)]

    def _every(self, rate: float, who: str) -> int:
        steps = 1.0 / (rate * self.plant.timestep)
        if abs(steps - round(steps)) > 1e-6 or steps < 1:
            physics = 1.0 / self.plant.timestep
            raise LoopError(f"{who} runs at {rate:g} Hz; valid: {physics:g} Hz divided by a whole number")
        return round(steps)

    def run(self, duration: float, head: Mapping[str, Any], progress: Callable[[float], None] | None = None) -> Log:
        """Fly for `duration` seconds.

        A run that fails keeps what it has: the log then ends early and `fault` says why.

        Args:
            duration: s.
            head: what the log should tell about the run.
            progress: called now and then with the simulated time.

        Raises:
            LoopError: a reference that nothing serves.
        """
        dt = self.plant.timestep
        steps = round(duration / dt)
        reference = self.wiring.reference
        table = LiveReference if isinstance(reference, Operator) else ReferenceTable
        tables = [table(e, reference, self._imu_every, steps, dt) for e in self.estimators]
        given: list[dict[str, Array]] = [{}, *self._handed]
        wanted = [
            table(c, reference, every, steps, dt, without=handed)
            for c, every, handed in zip(self.controllers, self._control_every, given, strict=True)
        ]
        recorder = Recorder(self.plant, self.controllers, given, reference, steps, self._sight, self._bus)
        self._solve_times: list[float] = []
        self._statuses = {block.name: Counter[str]() for block in (*self.estimators, *self.controllers)}
        pending = [deque[tuple[int, Callable[[], None]]]() for _ in self.controllers]
        started = clock.perf_counter()
        fault, done, start = "", 0, self.plant.base_pose()[:3]
        try:
            for k in range(steps):
                for name, every in self._joints_every.items():
                    if k % every == 0:
                        self._bus.update(self.sensors.joints.sample(name))
                if k % self._imu_every == 0:
                    self._sense(k, tables)
                if isinstance(reference, Operator) and k % self._control_every[0] == 0:
                    reference.decide(k * dt, self._bus | self.plant.objects_seen())
                for level, every in enumerate(self._control_every):
                    if k % every == 0:
                        late = self._control(k, level, wanted[level])
                        pending[level].append((k + round(late / dt), self._sent(level)))
                    while pending[level] and pending[level][0][0] <= k:
                        pending[level].popleft()[1]()
                recorder.record(k)
                self.plant.step()
                done = k + 1
                if k % WATCH_EVERY == 0:
                    self._watch(start, k * dt)
                    if progress is not None:
                        progress(k * dt)
        except (AerotactError, KeyboardInterrupt) as error:
            fault = str(error) or "interrupted"
        wall = clock.perf_counter() - started
        counts = {name: dict(statuses) for name, statuses in self._statuses.items()}
        outer, *inner = (counts.pop(c.name) for c in self.controllers)
        columns, ports = recorder.first(done)
        return Log(
            self.plant.timestep,
            columns,
            ports,
            dict(head),
            fault,
            wall,
            np.array(self._solve_times),
            outer,
            counts,
            max(self._control_every),
            {c.name: found for c, found in zip(self.controllers[1:], inner, strict=True)},
        )

    def _watch(self, start: Array, time: float) -> None:
        """End a flight that is lost, however far the plant would still compute it."""
        distance = float(np.linalg.norm(self.plant.base_pose()[:3] - start))
        if distance > LOST:
            raise LoopError(f"the robot is lost at {time:.2f} s: {distance:.0f} m from where it began")

    def _sense(self, k: int, tables: Sequence[ReferenceTable | LiveReference]) -> None:
        bus = self._bus
        bus.update(self.sensors.imu())
        bus.update(self.sensors.rotor_speed())
        bus.update(self.sensors.tilt_encoder())
        if k % self._force_every == 0:
            bus.update(self.sensors.force_torque())
        fresh = k % self._mocap_every == 0
        if fresh:
            bus.update(self.sensors.motion_capture())
        bus["mocap_fresh"] = np.array([float(fresh)])
        if self._sight and k % self._frame_every == 0:
            bus.update(self._sight.patch())
        for estimator, table in zip(self.estimators, tables, strict=False):
            table.write(k)
            for name, view in estimator.measurement.items():
                view[:] = bus[name]
            self._statuses[estimator.name][estimator.step().name] += 1
            bus.update(estimator.output)
            if self.wiring.truth:
                truth = self.plant.truth()
                bus.update({name: truth[name] for name in STATE_SIGNALS})
        if self._sight and self.wiring.truth:
            bus.update(self._sight.truth())

    def _control(self, k: int, level: int, table: ReferenceTable | LiveReference) -> float:
        controller = self.controllers[level]
        table.write(k)
        for name, view in controller.measurement.items():
            view[:] = self._bus[name]
        before = clock.perf_counter()
        status: Status = controller.step()
        taken = clock.perf_counter() - before
        if level == 0:
            self._solve_times.append(taken)
        self._statuses[controller.name][status.name] += 1
        delay, dt = self.wiring.delay, self.plant.timestep
        return float(np.ceil(taken / dt) * dt) if delay == "measured" else delay

    def _sent(self, level: int) -> Callable[[], None]:
        """What hands the outputs of now to the inner controller, or of the innermost to the plant."""
        output = self.controllers[level].output
        if level == len(self.controllers) - 1:
            commands = {COMMANDS[name]: output[name].copy() for name in self._commands}
            return lambda: self.plant.command(**commands)
        return _writer({name: (view, output[name].copy()) for name, view in self._handed[level].items()})


def _handed(outer: Controller, inner: Controller) -> dict[str, Array]:
    """The inner controller's references that the outer one gives, as writable views.

    Raises:
        LoopError: there are none, or one of another size.
    """
    handed = {name: view for name, view in inner.reference.items() if name in outer.output}
    if not handed:
        raise LoopError(
            f"{outer.name} gives {', '.join(outer.output)}, nothing that its inner controller {inner.name} follows; "
            f"valid: one or more of {', '.join(inner.reference) or 'nothing: it has no references'}"
        )
    for name, view in handed.items():
        if view.shape != outer.output[name].shape:
            raise LoopError(
                f"{outer.name} gives {name} of shape {outer.output[name].shape}; valid: {view.shape}, of {inner.name}"
            )
    return handed


def _writer(values: Mapping[str, tuple[Array, Array]]) -> Callable[[], None]:
    """What copies each second array into the first."""

    def write() -> None:
        for view, value in values.values():
            view[:] = value

    return write
