"""Arms: series-elastic joints in chains that end in a tool, and joints that nothing drives, as compiled from plant.xml.

A compliant joint is a hinge with one actuator whose activation is the servo's angle theta: its torque is
k (theta - q) - d q_rate, and the servo lags its command (suarez2020 (15), (17)).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from aerotact.exceptions import RobotError
from aerotact.plant_file import find_id, joints_between
from aerotact.robot_file import ArmEntry, PassiveEntry

_OBJ = mujoco.mjtObj


@dataclass(frozen=True)
class PassiveJoint:
    """A hinge that nothing drives.

    Attributes:
        name: of the joint.
        index: its id in plant.xml.
        damping: N m s/rad.
    """

    name: str
    index: int
    damping: float


@dataclass(frozen=True)
class CompliantJoint:
    """A hinge driven by a servo through a spring and a damper.

    Attributes:
        name: of the joint.
        index: its id in plant.xml.
        actuator: name of its actuator.
        actuator_index: id of its actuator.
        range: lowest and highest joint angle, rad.
        stiffness: k of suarez2020 (15), N m/rad.
        damping: d of suarez2020 (15), N m s/rad.
        bearing: damping between the links themselves, N m s/rad.
        servo: lowest and highest servo angle, rad.
        servo_rate: fastest servo rate, rad/s.
        time_constant: first-order lag of the servo, s.
        torque: stall torque, N m.
    """

    name: str
    index: int
    actuator: str
    actuator_index: int
    range: tuple[float, float]
    stiffness: float
    damping: float
    bearing: float
    servo: tuple[float, float]
    servo_rate: float
    time_constant: float
    torque: float


@dataclass(frozen=True)
class Arm:
    """A chain of compliant joints from a shoulder to a tool.

    Attributes:
        name: of the arm.
        tool: site at its end; z points out of the tool.
        tool_index: id of that site.
        joints: from the shoulder on.
    """

    name: str
    tool: str
    tool_index: int
    joints: tuple[CompliantJoint, ...]


def load_arms(entries: Sequence[ArmEntry], model: Any, key: int, folder: Path) -> tuple[Arm, ...]:
    """Arms of a compiled plant.xml.

    Args:
        entries: of robot.toml.
        model: compiled plant.xml.
        key: id of the hover keyframe.
        folder: of the robot.

    Raises:
        RobotError: a part that is missing or of another kind; names file, part, fault and remedy.
    """
    arms: list[Arm] = []
    taken: set[str] = set()
    for number, entry in enumerate(entries):
        part = f"arms[{number}]"
        if entry.name in [arm.name for arm in arms]:
            raise RobotError(folder / "robot.toml", f"{part}.name", f"'{entry.name}' stands twice", "name arms apart")
        tool = find_id(model, _OBJ.mjOBJ_SITE, entry.tool, f"{part}.tool", folder)
        rates = entry.servo_rate
        if rates.unit != "rad/s" or rates.array.shape != (len(entry.joints),) or not (rates.array > 0).all():
            raise RobotError(
                folder / "robot.toml",
                f"{part}.servo_rate",
                f"is {rates.value} {rates.unit}",
                f"give {len(entry.joints)} numbers > 0 in rad/s, one a joint",
            )
        joints = []
        for place, (name, rate) in enumerate(zip(entry.joints, rates.array, strict=True)):
            index = _hinge(model, name, f"{part}.joints[{place}]", folder, taken)
            joints.append(_compliant_joint(model, index, name, float(rate), key, folder))
        if joints[-1].index not in joints_between(model, int(model.site_bodyid[tool]), 0):
            raise RobotError(
                folder / "robot.toml",
                f"{part}.tool",
                f"site '{entry.tool}' does not move with joint '{entry.joints[-1]}'",
                "list the joints from the shoulder to the tool",
            )
        arms.append(Arm(entry.name, entry.tool, tool, tuple(joints)))
    return tuple(arms)


def load_passive(entry: PassiveEntry | None, model: Any, folder: Path) -> tuple[PassiveJoint, ...]:
    """Passive joints of a compiled plant.xml.

    Raises:
        RobotError: a joint that is missing, no hinge, listed twice or driven.
    """
    joints: list[PassiveJoint] = []
    taken: set[str] = set()
    for place, name in enumerate(entry.joints if entry else ()):
        part = f"passive.joints[{place}]"
        index = _hinge(model, name, part, folder, taken)
        if _drivers(model, index):
            driver = model.actuator(_drivers(model, index)[0]).name
            raise RobotError(folder / "robot.toml", part, f"'{name}' is driven by actuator '{driver}'", "leave it out")
        joints.append(PassiveJoint(name, index, float(model.dof_damping[model.jnt_dofadr[index]])))
    return tuple(joints)


def check_listing(
    arms: Sequence[Arm], passive: Sequence[PassiveJoint], model: Any, bodies: list[int], folder: Path
) -> None:
    """See that a robot with arms or passive joints lists all its joints but the free one.

    Args:
        arms: of the robot.
        passive: of the robot.
        model: compiled plant.xml.
        bodies: of the robot.
        folder: of the robot.

    Raises:
        RobotError: names the first joint that stands in no list, or in two.
    """
    listed = [joint.name for joint in passive] + [joint.name for arm in arms for joint in arm.joints]
    for index in range(model.njnt) if listed else ():
        name = model.joint(index).name
        own = model.jnt_bodyid[index] in bodies and model.jnt_type[index] != mujoco.mjtJoint.mjJNT_FREE
        if own and listed.count(name) != 1:
            raise RobotError(
                folder / "robot.toml",
                "arms",
                f"joint '{name}' of plant.xml stands in {listed.count(name)} lists",
                "list each joint once, under arms if a servo drives it, under passive if nothing does",
            )


def _hinge(model: Any, name: str, part: str, folder: Path, taken: set[str]) -> int:
    index = find_id(model, _OBJ.mjOBJ_JOINT, name, part, folder)
    if model.jnt_type[index] != mujoco.mjtJoint.mjJNT_HINGE:
        raise RobotError(folder / "plant.xml", f"joint '{name}'", "is no hinge", 'use type="hinge"')
    if name in taken:
        raise RobotError(folder / "robot.toml", part, f"'{name}' is listed twice", "list each joint once")
    taken.add(name)
    return index


def _drivers(model: Any, joint: int) -> list[int]:
    """Ids of the actuators on a joint."""
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return [int(i) for i in np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))]


def _compliant_joint(model: Any, joint: int, name: str, rate: float, key: int, folder: Path) -> CompliantJoint:
    plant, drivers = folder / "plant.xml", _drivers(model, joint)
    if len(drivers) != 1:
        raise RobotError(
            plant, f"joint '{name}'", f"has {len(drivers)} actuators", 'give it one <general joint="..."> as servo'
        )
    index = drivers[0]
    actuator = model.actuator(index).name
    part = f"actuator '{actuator}'"
    if model.actuator_dyntype[index] != mujoco.mjtDyn.mjDYN_FILTEREXACT or model.actuator_dynprm[index, 0] <= 0:
        raise RobotError(plant, part, "has no servo lag", 'use dyntype="filterexact", dynprm="time constant in s"')
    gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
    sound = model.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED
    sound &= model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
    if not sound or gain[0] <= 0 or bias[0] != 0 or bias[1] != -gain[0]:
        raise RobotError(
            plant, part, "is no spring and damper", 'use gainprm="k", biastype="affine", biasprm="0 -k -d", k > 0'
        )
    if model.actuator_gear[index, 0] != 1.0:
        raise RobotError(plant, part, f"gear is {model.actuator_gear[index, 0]:g}", "leave the gear out")
    if not (model.actuator_ctrllimited[index] and model.actuator_forcelimited[index] and model.jnt_limited[joint]):
        raise RobotError(
            plant,
            part,
            "lacks a limit",
            "give ctrlrange (servo angle, rad), forcerange (stall torque, N m) and the joint's range",
        )
    weakest = float(min(-model.actuator_forcerange[index, 0], model.actuator_forcerange[index, 1]))
    if weakest <= 0:
        raise RobotError(plant, part, "cannot push both ways", 'use forcerange="-torque torque"')
    if model.key_act[key, model.actuator_actadr[index]] != model.key_ctrl[key, index]:
        raise RobotError(
            plant, "hover keyframe", f"act and ctrl of '{actuator}' differ", "give both the servo's angle at hover"
        )
    lower, upper = (float(v) for v in model.jnt_range[joint])
    servo_lower, servo_upper = (float(v) for v in model.actuator_ctrlrange[index])
    return CompliantJoint(
        name=name,
        index=joint,
        actuator=actuator,
        actuator_index=index,
        range=(lower, upper),
        stiffness=float(gain[0]),
        damping=float(-bias[2]),
        bearing=float(model.dof_damping[model.jnt_dofadr[joint]]),
        servo=(servo_lower, servo_upper),
        servo_rate=rate,
        time_constant=float(model.actuator_dynprm[index, 0]),
        torque=weakest,
    )
