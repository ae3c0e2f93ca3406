"""Robot: one frozen noun from a folder with plant.xml (all physics) and robot.toml (names, limits, sensors, gains)."""

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydantic import Field, ValidationError

from aerotact.arms import (
    Arm,
    ArmEntry,
    EncoderEntry,
    PassiveEntry,
    PassiveJoint,
    ServoEntry,
    load_arms,
    load_passive,
)
from aerotact.exceptions import RobotError
from aerotact.parts import Quantity, Strict, part_id
from aerotact.ports import Array
from aerotact.resources import find_robot

HOVER_KEYFRAME = "hover"


class RobotNames(Strict):
    """Names of the parts in plant.xml."""

    base: str
    tool: str | None = None
    imu: str = "imu"


class RotorEntry(Strict):
    """One rotor: its actuator in plant.xml and its limits."""

    actuator: str
    thrust_rate: Quantity


class ImuEntry(Strict):
    """Inertial measurement unit: rate in Hz, standard deviations a sample, standard deviations of the constant bias."""

    rate: float = Field(gt=0)
    accelerometer_noise: Quantity
    gyro_noise: Quantity
    accelerometer_bias: Quantity
    gyro_bias: Quantity


class MotionCaptureEntry(Strict):
    """Motion capture: rate in Hz, standard deviations a sample."""

    rate: float = Field(gt=0)
    position_noise: Quantity
    attitude_noise: Quantity


class RotorSpeedEntry(Strict):
    """Measured rotor speeds, given as thrust: standard deviation a sample."""

    thrust_noise: Quantity


class SensorEntries(Strict):
    """The sensors that the robot carries."""

    imu: ImuEntry
    motion_capture: MotionCaptureEntry
    rotor_speed: RotorSpeedEntry
    servo: ServoEntry | None = None
    deflection: EncoderEntry | None = None
    passive: EncoderEntry | None = None


class RobotFile(Strict):
    """The schema of robot.toml."""

    robot: RobotNames
    rotors: list[RotorEntry] = Field(min_length=1)
    arms: list[ArmEntry] = Field(default_factory=list)
    passive: PassiveEntry | None = None
    sensors: SensorEntries
    gains: dict[str, dict[str, Quantity]] = Field(default_factory=dict)


@dataclass(frozen=True)
class Rotor:
    """A rotor as compiled from plant.xml.

    Attributes:
        actuator: name and index (`index`) of its actuator.
        p_BR: position of its site in B, m, shape (3,).
        axis_B: thrust direction in B, shape (3,).
        drag: torque about `axis_B` per newton of thrust, N m/N.
        thrust: lowest and highest thrust, N.
        thrust_rate: lowest and highest rate of the actual thrust, N/s.
        time_constant: first-order lag from commanded to actual thrust, s.
    """

    actuator: str
    index: int
    p_BR: Array
    axis_B: Array
    drag: float
    thrust: tuple[float, float]
    thrust_rate: tuple[float, float]
    time_constant: float


@dataclass(frozen=True)
class Robot:
    """A robot folder, loaded and validated.

    Attributes:
        folder: where it was read from.
        file: the parsed robot.toml.
        mjmodel: the compiled plant.xml.
        base_id: body that carries the free joint.
        mass: of everything below the base, kg.
        p_BC: centre of mass in B, m, shape (3,).
        J_C: inertia about the centre of mass in B's axes, kg m2, shape (3, 3).
        rotors: in the order of robot.toml.
        p_BE, R_BE: tool pose in B (zero and identity if `has_tool` is false); the tool's z axis points out of it.
        p_BI: IMU position in B, m.
        gravity: magnitude along -z of W, m/s2.
        hover_thrust: thrusts of the hover keyframe, N, shape (n,).
        arms: in the order of robot.toml.
        passive: joints that nothing drives, in the order of robot.toml.
    """

    folder: Path
    file: RobotFile
    mjmodel: Any
    base_id: int
    mass: float
    p_BC: Array
    J_C: Array
    rotors: tuple[Rotor, ...]
    has_tool: bool
    p_BE: Array
    R_BE: Array
    p_BI: Array
    gravity: float
    hover_thrust: Array
    arms: tuple[Arm, ...] = ()
    passive: tuple[PassiveJoint, ...] = ()

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    def gains(self, block: str) -> dict[str, Quantity]:
        """Gains of robot.toml for a law or an estimator, by parameter name; empty if it gives none."""
        return self.file.gains.get(block, {})


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings instead of letting it write a log file into the working directory."""
    caught: list[str] = []
    mujoco.set_mju_user_warning(caught.append)
    try:
        yield caught
    finally:
        mujoco.set_mju_user_warning(lambda message: None)


def _read_toml(path: Path) -> RobotFile:
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


def _compile(path: Path) -> Any:
    if not path.is_file():
        raise RobotError(path, "file", "does not exist", "a robot folder holds plant.xml and robot.toml")
    with mujoco_warnings() as warnings:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise RobotError(path, "model", str(error).strip().replace("\n", " "), "mend the named element") from error
    if warnings:
        raise RobotError(path, "model", f"MuJoCo warns: {warnings[0]}", "mend the cause of the warning")
    return model


def _lumped_inertia(model: Any, data: Any, base: int, folder: Path) -> tuple[float, Array, Array]:
    """Mass, centre of mass in B and inertia about it in B's axes of the base's subtree at the model's zero pose."""
    bodies = [b for b in range(model.nbody) if model.body_rootid[b] == model.body_rootid[base] and b != 0]
    masses = model.body_mass[bodies]
    if masses.sum() <= 0 or (masses < 0).any():
        raise RobotError(folder / "plant.xml", "mass", f"total is {masses.sum():g} kg", "give every body a mass > 0")
    R_WB = data.xmat[base].reshape(3, 3)
    p_WC = (masses[:, None] * data.xipos[bodies]).sum(axis=0) / masses.sum()
    inertia = np.zeros((3, 3))
    for body, mass in zip(bodies, masses, strict=True):
        R_WI = data.ximat[body].reshape(3, 3)
        r = data.xipos[body] - p_WC
        inertia += R_WI @ np.diag(model.body_inertia[body]) @ R_WI.T + mass * (r @ r * np.eye(3) - np.outer(r, r))
    return float(masses.sum()), R_WB.T @ (p_WC - data.xpos[base]), R_WB.T @ inertia @ R_WB


def _rotor(entry: RotorEntry, number: int, model: Any, data: Any, base: int, folder: Path) -> Rotor:
    part = f"rotors[{number}]"
    plant = folder / "plant.xml"
    index = part_id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, entry.actuator, f"{part}.actuator", folder)
    if model.actuator_trntype[index] != mujoco.mjtTrn.mjTRN_SITE:
        raise RobotError(plant, f"actuator '{entry.actuator}'", "has no site", 'give it site="..." as transmission')
    gear = model.actuator_gear[index]
    if not np.allclose(gear[[0, 1, 3, 4]], 0.0) or not np.isclose(gear[2], 1.0):
        raise RobotError(
            plant, f"actuator '{entry.actuator}'", f"gear is {gear.tolist()}", 'use gear="0 0 1 0 0 c": thrust along z'
        )
    if not model.actuator_ctrllimited[index]:
        raise RobotError(plant, f"actuator '{entry.actuator}'", "has no ctrlrange", "give the thrust range in newtons")
    if model.actuator_dyntype[index] != mujoco.mjtDyn.mjDYN_FILTEREXACT or model.actuator_dynprm[index, 0] <= 0:
        raise RobotError(
            plant,
            f"actuator '{entry.actuator}'",
            "has no rotor lag",
            'use dyntype="filterexact" and dynprm="time constant in s"',
        )
    if model.actuator_gainprm[index, 0] != 1.0 or model.actuator_biastype[index] != mujoco.mjtBias.mjBIAS_NONE:
        raise RobotError(
            plant,
            f"actuator '{entry.actuator}'",
            "its force is not its activation",
            "use <general> with gain 1, no bias",
        )
    lower, upper = (float(v) for v in model.actuator_ctrlrange[index])
    rate = entry.thrust_rate
    if rate.unit != "N/s" or rate.array.shape != (2,) or not rate.array[0] < 0 < rate.array[1]:
        raise RobotError(
            folder / "robot.toml",
            f"{part}.thrust_rate",
            f"is {rate.value} {rate.unit}",
            "give [lowest, highest] in N/s with lowest < 0 < highest",
        )
    site = model.actuator_trnid[index, 0]
    R_WB = data.xmat[base].reshape(3, 3)
    return Rotor(
        actuator=entry.actuator,
        index=index,
        p_BR=R_WB.T @ (data.site_xpos[site] - data.xpos[base]),
        axis_B=R_WB.T @ data.site_xmat[site].reshape(3, 3)[:, 2],
        drag=float(gear[5]),
        thrust=(lower, upper),
        thrust_rate=(float(rate.array[0]), float(rate.array[1])),
        time_constant=float(model.actuator_dynprm[index, 0]),
    )


def load_robot(name_or_path: str | Path) -> Robot:
    """Read and validate a robot folder.

    Raises:
        UnknownName: no such folder or robot.
        RobotError: names the file, the part, the fault and the remedy.
    """
    folder = find_robot(name_or_path)
    file = _read_toml(folder / "robot.toml")
    model = _compile(folder / "plant.xml")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = part_id(model, mujoco.mjtObj.mjOBJ_BODY, file.robot.base, "robot.base", folder)
    joint = model.body_jntadr[base]
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        raise RobotError(folder / "plant.xml", f"body '{file.robot.base}'", "has no free joint", "add <freejoint/>")
    mass, p_BC, J_C = _lumped_inertia(model, data, base, folder)
    R_WB, p_WB = data.xmat[base].reshape(3, 3), data.xpos[base]
    p_BE, R_BE = np.zeros(3), np.eye(3)
    if file.robot.tool is not None:
        site = part_id(model, mujoco.mjtObj.mjOBJ_SITE, file.robot.tool, "robot.tool", folder)
        p_BE = R_WB.T @ (data.site_xpos[site] - p_WB)
        R_BE = R_WB.T @ data.site_xmat[site].reshape(3, 3)
    imu = part_id(model, mujoco.mjtObj.mjOBJ_SITE, file.robot.imu, "robot.imu", folder)
    key = part_id(model, mujoco.mjtObj.mjOBJ_KEY, HOVER_KEYFRAME, "hover keyframe", folder)
    rotors = tuple(_rotor(entry, i, model, data, base, folder) for i, entry in enumerate(file.rotors))
    indices = [rotor.index for rotor in rotors]
    for number, rotor in enumerate(rotors):
        if rotor.index in indices[:number]:
            part = f"rotors[{number}].actuator"
            raise RobotError(folder / "robot.toml", part, f"'{rotor.actuator}' is listed twice", "list each rotor once")
    if not np.array_equal(model.key_act[key][model.actuator_actadr[indices]], model.key_ctrl[key][indices]):
        raise RobotError(
            folder / "plant.xml", "hover keyframe", "act and ctrl of the rotors differ", "give both the hover thrusts"
        )
    return Robot(
        folder=folder,
        file=file,
        mjmodel=model,
        base_id=base,
        mass=mass,
        p_BC=p_BC,
        J_C=J_C,
        rotors=rotors,
        has_tool=file.robot.tool is not None,
        p_BE=p_BE,
        R_BE=R_BE,
        p_BI=R_WB.T @ (data.site_xpos[imu] - p_WB),
        gravity=float(-model.opt.gravity[2]),
        hover_thrust=model.key_ctrl[key][indices].copy(),
        arms=load_arms(file.arms, model, key, folder),
        passive=load_passive(file.passive, model, folder),
    )
