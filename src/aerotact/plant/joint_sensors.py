"""Sensors of joints: servo angles as servos report them, and encoders of deflections and of passive joints."""

import numpy as np

from aerotact.exceptions import RobotError
from aerotact.plant.plant import Plant
from aerotact.ports import Array
from aerotact.robot import Robot
from aerotact.robot_file import EncoderEntry, Quantity


class JointSensors:
    """Simulated sensors of joints; each call is one sample, so call them at their rates.

    Attributes:
        rates: Hz by signal: servo_measured, deflection_measured, passive_measured; only those that there are.
        biases: constant errors of the encoders by signal, rad, drawn once.
    """

    def __init__(self, plant: Plant, robot: Robot, rng: np.random.Generator) -> None:
        """Draw the biases.

        Raises:
            RobotError: an encoder on a joint that is not there, or a value of the wrong unit or sign.
        """
        self._plant, self._rng, self._file = plant, rng, robot.folder / "robot.toml"
        entries, joints = robot.file.sensors, plant.joints
        self.rates: dict[str, float] = {}
        self.biases: dict[str, Array] = {}
        self._noise: dict[str, float] = {}
        self._places: dict[str, list[int]] = {}
        if entries.servo is not None:
            self._step = self._level("servo.resolution", entries.servo.resolution)
            if not joints.servos:
                raise RobotError(self._file, "sensors.servo", "there are no arms", "leave the sensor out")
            self.rates["servo_measured"] = entries.servo.rate
        passive = joints.names[: len(joints.names) - len(joints.servos)]
        for label, entry, valid in (
            ("deflection", entries.deflection, joints.servos),
            ("passive", entries.passive, passive),
        ):
            if entry is not None:
                self._begin(label, entry, valid)

    def _begin(self, label: str, entry: EncoderEntry, valid: tuple[str, ...]) -> None:
        signal = f"{label}_measured"
        self._places[signal] = self._known(label, entry.joints, valid)
        self._noise[signal] = self._level(f"{label}.noise", entry.noise)
        level = self._level(f"{label}.bias", entry.bias)
        self.biases[signal] = level * self._rng.normal(size=len(entry.joints))
        self.rates[signal] = entry.rate

    def _known(self, label: str, names: list[str], valid: tuple[str, ...]) -> list[int]:
        for place, name in enumerate(names):
            if name not in valid:
                raise RobotError(
                    self._file,
                    f"sensors.{label}.joints[{place}]",
                    f"there is no such joint '{name}' to measure",
                    f"name one of: {', '.join(valid) or 'none, so leave the sensor out'}",
                )
        return [valid.index(name) for name in names]

    def _level(self, part: str, quantity: Quantity) -> float:
        value = quantity.array
        if quantity.unit != "rad" or value.shape != () or not (np.isfinite(value) and value >= 0.0):
            raise RobotError(
                self._file, f"sensors.{part}", f"is {quantity.value} {quantity.unit}", "give one number >= 0 in rad"
            )
        return float(value)

    def sample(self, signal: str) -> dict[str, Array]:
        """One sample of one of `rates`.

        Returns:
            servo_measured: angle of each servo's shaft in steps of its resolution, rad, shape (s,);
            deflection_measured: shaft minus link, (14), of the joints that robot.toml names, with bias and noise, rad;
            passive_measured: angle of the passive joints that robot.toml names, with bias and noise, rad.
        """
        joints = self._plant.joints
        shafts, angles = joints.shafts(), joints.angles()
        if signal == "servo_measured":
            return {signal: shafts if self._step == 0.0 else self._step * np.round(shafts / self._step)}
        passive = angles.size - shafts.size
        true = shafts - angles[passive:] if signal == "deflection_measured" else angles[:passive]
        noise = self._noise[signal] * self._rng.normal(size=len(self._places[signal]))
        return {signal: true[self._places[signal]] + self.biases[signal] + noise}

    def samples(self) -> dict[str, Array]:
        """One sample of each."""
        return {name: value for signal in self.rates for name, value in self.sample(signal).items()}
