"""RobotFile: robot.toml, validated: names of parts, limits, sensors and gains, each number with unit and source."""

import tomllib
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from aerotact.exceptions import RobotError
from aerotact.ports import Array


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Quantity(_Strict):
    """A number or a list of numbers with its unit and where it comes from."""

    value: float | list[float]
    unit: str
    source: str = Field(min_length=1)

    @property
    def array(self) -> Array:
        """The value as an array of shape () or (n,)."""
        return np.asarray(self.value, dtype=float)


class RobotNames(_Strict):
    """Names of the parts in plant.xml."""

    base: str
    tool: str | None = None
    imu: str = "imu"


class RotorEntry(_Strict):
    """One rotor: its actuator in plant.xml, the joint that tilts it if one does, and its limits."""

    actuator: str
    thrust_rate: Quantity
    tilt: str | None = None
    tilt_rate: Quantity | None = None


class ImuEntry(_Strict):
    """Inertial measurement unit: rate in Hz, standard deviations a sample, standard deviations of the constant bias."""

    rate: float = Field(gt=0)
    accelerometer_noise: Quantity
    gyro_noise: Quantity
    accelerometer_bias: Quantity
    gyro_bias: Quantity


class MotionCaptureEntry(_Strict):
    """Motion capture: rate in Hz, standard deviations a sample."""

    rate: float = Field(gt=0)
    position_noise: Quantity
    attitude_noise: Quantity


class RotorSpeedEntry(_Strict):
    """Measured rotor speeds, given as thrust: standard deviation a sample."""

    thrust_noise: Quantity


class TiltEncoderEntry(_Strict):
    """Measured angles of the tilt servos: standard deviation a sample."""

    angle_noise: Quantity


class ForceTorqueEntry(_Strict):
    """Force/torque sensor: its site in plant.xml, rate in Hz, standard deviations a sample and of the bias at the
    start, and the random walk of the force's bias."""

    site: str
    rate: float = Field(gt=0)
    force_noise: Quantity
    torque_noise: Quantity
    force_bias: Quantity
    torque_bias: Quantity
    drift: Quantity


class DepthCameraEntry(_Strict):
    """Time-of-flight camera: rate in Hz, columns and rows, angles of view, shortest and longest range, noise.

    Its site looks along z, with x to the right of the picture and y down.
    """

    site: str
    rate: float = Field(gt=0)
    resolution: tuple[int, int]
    field_of_view: Quantity
    range: Quantity
    range_noise: Quantity


class ArmEntry(_Strict):
    """An arm: its tool's site and its joints from the shoulder on; `servo_rate`: fastest servo rates, one a joint."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    tool: str
    joints: list[str] = Field(min_length=1)
    servo_rate: Quantity


class PassiveEntry(_Strict):
    """Hinges that nothing drives, the nearest to the base first."""

    joints: list[str] = Field(min_length=1)


class EncoderEntry(_Strict):
    """Encoders on some joints: rate in Hz, standard deviations a sample and of the constant bias."""

    joints: list[str] = Field(min_length=1)
    rate: float = Field(gt=0)
    noise: Quantity
    bias: Quantity


class ServoEntry(_Strict):
    """Servo angles as the servos report them: rate in Hz, step of the reported angle."""

    rate: float = Field(gt=0)
    resolution: Quantity


class SensorEntries(_Strict):
    """The sensors that the robot carries."""

    imu: ImuEntry
    motion_capture: MotionCaptureEntry
    rotor_speed: RotorSpeedEntry
    tilt_encoder: TiltEncoderEntry | None = None
    force_torque: ForceTorqueEntry | None = None
    depth_camera: DepthCameraEntry | None = None
    servo: ServoEntry | None = None
    deflection: EncoderEntry | None = None
    passive: EncoderEntry | None = None


class RobotFile(_Strict):
    """The schema of robot.toml."""

    robot: RobotNames
    rotors: list[RotorEntry] = Field(min_length=1)
    arms: list[ArmEntry] = Field(default_factory=list)
    passive: PassiveEntry | None = None
    sensors: SensorEntries
    gains: dict[str, dict[str, Quantity]] = Field(default_factory=dict)


def read_robot_file(path: Path) -> RobotFile:
    """Read and validate robot.toml.

    Raises:
        RobotError: names the part, the fault and the remedy.
    """
    if not path.is_file():
        raise RobotError(path, "file", "does not exist", "a robot folder holds plant.xml and robot.toml")
    try:
        data = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RobotError(path, "file", f"is not TOML: {error}", "mend the named line") from error
    try:
        return RobotFile.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        part = ".".join(str(p) for p in first["loc"])
        remedy = "mend it as said"
        if first["type"] == "extra_forbidden":
            remedy = "remove the key or correct its spelling"
        elif first["type"] == "missing":
            remedy = "add the key"
        raise RobotError(path, part, f"{first['msg']} (got {first['input']!r})"[:300], remedy) from error
