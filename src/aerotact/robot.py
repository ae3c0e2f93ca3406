"""Robot: one frozen noun from a folder with plant.xml (all physics) and robot.toml (names, limits, sensors, gains)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from aerotact.arms import Arm, PassiveJoint, check_listing, load_arms, load_passive
from aerotact.exceptions import RobotError
from aerotact.plant_file import compile_plant, find_id, joints_between, lumped, subtree
from aerotact.ports import Array
from aerotact.resources import find_robot
from aerotact.robot_file import Quantity, RobotFile, RotorEntry, read_robot_file

HOVER_KEYFRAME = "hover"
_OBJ = mujoco.mjtObj


@dataclass(frozen=True)
class Tilt:
    """The hinge that tilts a rotor, and its servo: first-order lag towards the commanded angle, at a limited rate.

    Attributes:
        joint: name of the hinge.
        actuator: name and index (`index`) of the servo.
        p_BH: a point on the hinge's axis in B, m, shape (3,).
        axis_B: unit vector of the hinge's axis in B, shape (3,).
        angle: lowest and highest angle, rad.
        rate: lowest and highest rate of the actual angle, rad/s.
        time_constant: of the lag, s.
    """

    joint: str
    actuator: str
    index: int
    p_BH: Array
    axis_B: Array
    angle: tuple[float, float]
    rate: tuple[float, float]
    time_constant: float


@dataclass(frozen=True)
class Rotor:
    """A rotor as compiled from plant.xml.

    Attributes:
        actuator: name and index (`index`) of its actuator.
        p_BR: position of its site in B, m, shape (3,); if it tilts, at angle 0.
        axis_B: thrust direction in B, shape (3,); if it tilts, at angle 0.
        drag: torque about `axis_B` per newton of thrust, N m/N.
        thrust: lowest and highest thrust, N.
        thrust_rate: lowest and highest rate of the actual thrust, N/s.
        time_constant: first-order lag from commanded to actual thrust, s.
        tilt: what tilts it, or None.
    """

    actuator: str
    index: int
    p_BR: Array
    axis_B: Array
    drag: float
    thrust: tuple[float, float]
    thrust_rate: tuple[float, float]
    time_constant: float
    tilt: Tilt | None = None


@dataclass(frozen=True)
class ForceTorque:
    """A six-axis force/torque sensor between the base and the tool.

    Attributes:
        site: its name.
        p_BS, R_BS: its pose in B, m, shapes (3,) and (3, 3); S is the sensor's frame.
        distal_mass: of what it carries, kg.
        p_SD: centre of mass D of what it carries in S, m, shape (3,).
    """

    site: str
    p_BS: Array
    R_BS: Array
    distal_mass: float
    p_SD: Array


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
        J_C: inertia about the centre of mass in B's axes, kg m2, shape (3, 3), with the rotors tilted as in hover.
        rotors: in the order of robot.toml.
        p_BE, R_BE: tool pose in B (zero and identity if `has_tool` is false); the tool's z axis points out of it.
        p_BI: IMU position in B, m.
        gravity: magnitude along -z of W, m/s2.
        hover_thrust: thrusts of the hover keyframe, N, shape (n,).
        hover_tilt: tilt angles of the hover keyframe, rad, shape (m,), one for each rotor that tilts.
        force_torque: the sensor between base and tool, or None.
        arms: in the order of robot.toml; `p_BC`, `J_C`, `p_BE` and `R_BE` are those with all their joints at zero.
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
    hover_tilt: Array
    force_torque: ForceTorque | None = None
    arms: tuple[Arm, ...] = ()
    passive: tuple[PassiveJoint, ...] = ()

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def tilts(self) -> tuple[Tilt, ...]:
        """What tilts, in the order of the rotors."""
        return tuple(rotor.tilt for rotor in self.rotors if rotor.tilt is not None)

    def gains(self, block: str) -> dict[str, Quantity]:
        """Gains of robot.toml for a law or an estimator, by parameter name; empty if it gives none."""
        return self.file.gains.get(block, {})


def _check_lag(model: Any, index: int, name: str, kind: str, plant: Path) -> None:
    """An actuator whose activation follows its command with a first-order lag within a range."""
    if not model.actuator_ctrllimited[index]:
        what = "the thrust range in newtons" if kind == "rotor" else "the range of angles"
        raise RobotError(plant, f"actuator '{name}'", "has no ctrlrange", f"give {what}")
    if model.actuator_dyntype[index] != mujoco.mjtDyn.mjDYN_FILTEREXACT or model.actuator_dynprm[index, 0] <= 0:
        raise RobotError(
            plant,
            f"actuator '{name}'",
            f"has no {kind} lag",
            'use dyntype="filterexact" and dynprm="time constant in s"',
        )


def _range(rate: Quantity, unit: str, part: str, folder: Path) -> tuple[float, float]:
    """Lowest and highest rate; one number stands for both ways."""
    value = rate.array
    if unit == "rad/s" and value.shape == ():
        value = np.array([-value, value])
    if rate.unit != unit or value.shape != (2,) or not value[0] < 0 < value[1]:
        raise RobotError(
            folder / "robot.toml",
            part,
            f"is {rate.value} {rate.unit}",
            f"give [lowest, highest] in {unit} with lowest < 0 < highest",
        )
    return float(value[0]), float(value[1])


def _tilt(entry: RotorEntry, site: int, part: str, model: Any, data: Any, base: int, folder: Path) -> Tilt | None:
    """The hinge of a rotor whose site is `site`, and its servo."""
    plant, toml = folder / "plant.xml", folder / "robot.toml"
    if entry.tilt is None:
        if entry.tilt_rate is not None:
            raise RobotError(toml, f"{part}.tilt_rate", "is of a rotor without tilt", "name its hinge under tilt")
        return None
    if entry.tilt_rate is None:
        raise RobotError(toml, f"{part}.tilt_rate", "is missing", f"give the rate of joint '{entry.tilt}' in rad/s")
    joint = find_id(model, _OBJ.mjOBJ_JOINT, entry.tilt, f"{part}.tilt", folder)
    label = f"joint '{entry.tilt}'"
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        raise RobotError(plant, label, "is no hinge", 'tilt a rotor by type="hinge"')
    if joints_between(model, model.site_bodyid[site], base) != [joint]:
        remedy = "put the rotor's site on a body with this joint and no other between it and the base"
        raise RobotError(plant, label, f"does not alone carry the rotor of actuator '{entry.actuator}'", remedy)
    on_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    servos = np.flatnonzero(on_joint)
    if servos.size != 1:
        raise RobotError(plant, label, f"has {servos.size} servos", f'give it one <general joint="{entry.tilt}" .../>')
    index = int(servos[0])
    name = model.actuator(index).name
    _check_lag(model, index, name, "servo", plant)
    gain, bias = model.actuator_gainprm[index, 0], model.actuator_biasprm[index, :3]
    affine = model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
    unit_gear = np.isclose(model.actuator_gear[index, 0], 1.0)
    if not (affine and unit_gear and gain > 0 and bias[0] == 0 and bias[1] == -gain and bias[2] <= 0):
        raise RobotError(
            plant,
            f"actuator '{name}'",
            "does not hold the angle that is its activation",
            'use gainprm="k" biastype="affine" biasprm="0 -k -d", gear 1',
        )
    R_WB = data.xmat[base].reshape(3, 3)
    lower, upper = (float(v) for v in model.actuator_ctrlrange[index])
    return Tilt(
        joint=entry.tilt,
        actuator=name,
        index=index,
        p_BH=R_WB.T @ (data.xanchor[joint] - data.xpos[base]),
        axis_B=R_WB.T @ data.xaxis[joint],
        angle=(lower, upper),
        rate=_range(entry.tilt_rate, "rad/s", f"{part}.tilt_rate", folder),
        time_constant=float(model.actuator_dynprm[index, 0]),
    )


def _rotor(entry: RotorEntry, number: int, model: Any, data: Any, base: int, folder: Path) -> Rotor:
    part = f"rotors[{number}]"
    plant = folder / "plant.xml"
    index = find_id(model, _OBJ.mjOBJ_ACTUATOR, entry.actuator, f"{part}.actuator", folder)
    if model.actuator_trntype[index] != mujoco.mjtTrn.mjTRN_SITE:
        raise RobotError(plant, f"actuator '{entry.actuator}'", "has no site", 'give it site="..." as transmission')
    gear = model.actuator_gear[index]
    if not np.allclose(gear[[0, 1, 3, 4]], 0.0) or not np.isclose(gear[2], 1.0):
        raise RobotError(
            plant, f"actuator '{entry.actuator}'", f"gear is {gear.tolist()}", 'use gear="0 0 1 0 0 c": thrust along z'
        )
    _check_lag(model, index, entry.actuator, "rotor", plant)
    if model.actuator_gainprm[index, 0] != 1.0 or model.actuator_biastype[index] != mujoco.mjtBias.mjBIAS_NONE:
        raise RobotError(
            plant,
            f"actuator '{entry.actuator}'",
            "its force is not its activation",
            "use <general> with gain 1, no bias",
        )
    lower, upper = (float(v) for v in model.actuator_ctrlrange[index])
    site = model.actuator_trnid[index, 0]
    R_WB = data.xmat[base].reshape(3, 3)
    return Rotor(
        actuator=entry.actuator,
        index=index,
        p_BR=R_WB.T @ (data.site_xpos[site] - data.xpos[base]),
        axis_B=R_WB.T @ data.site_xmat[site].reshape(3, 3)[:, 2],
        drag=float(gear[5]),
        thrust=(lower, upper),
        thrust_rate=_range(entry.thrust_rate, "N/s", f"{part}.thrust_rate", folder),
        time_constant=float(model.actuator_dynprm[index, 0]),
        tilt=_tilt(entry, site, part, model, data, base, folder),
    )


def _force_torque(site_name: str, model: Any, data: Any, base: int, folder: Path) -> ForceTorque:
    part = "sensors.force_torque.site"
    site = find_id(model, _OBJ.mjOBJ_SITE, site_name, part, folder)
    body = model.site_bodyid[site]
    if body == base or base not in _ancestors(model, body) or joints_between(model, body, base):
        raise RobotError(
            folder / "plant.xml",
            f"site '{site_name}'",
            "is not on a body of its own below the base",
            "put it on the body that carries the tool, welded to the base",
        )
    R_WB, R_WS = data.xmat[base].reshape(3, 3), data.site_xmat[site].reshape(3, 3)
    mass, p_WD, _ = lumped(model, data, subtree(model, body))
    return ForceTorque(
        site=site_name,
        p_BS=R_WB.T @ (data.site_xpos[site] - data.xpos[base]),
        R_BS=R_WB.T @ R_WS,
        distal_mass=mass,
        p_SD=R_WS.T @ (p_WD - data.site_xpos[site]),
    )


def _ancestors(model: Any, body: int) -> list[int]:
    found = []
    while body:
        body = int(model.body_parentid[body])
        found.append(body)
    return found


def _check_listing(rotors: tuple[Rotor, ...], folder: Path) -> None:
    """No actuator and no hinge serves two rotors."""
    seen: set[str] = set()
    for number, rotor in enumerate(rotors):
        names = [("actuator", rotor.actuator), *([("tilt", rotor.tilt.joint)] if rotor.tilt else [])]
        for key, name in names:
            if name in seen:
                part = f"rotors[{number}].{key}"
                raise RobotError(folder / "robot.toml", part, f"'{name}' is listed twice", "list each rotor once")
            seen.add(name)


def load_robot(name_or_path: str | Path) -> Robot:
    """Read and validate a robot folder.

    Raises:
        UnknownName: no such folder or robot.
        RobotError: names the file, the part, the fault and the remedy.
    """
    folder = find_robot(name_or_path)
    file = read_robot_file(folder / "robot.toml")
    plant = folder / "plant.xml"
    model = compile_plant(plant)
    data = mujoco.MjData(model)
    base = find_id(model, _OBJ.mjOBJ_BODY, file.robot.base, "robot.base", folder)
    joint = model.body_jntadr[base]
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        raise RobotError(plant, f"body '{file.robot.base}'", "has no free joint", "add <freejoint/>")
    hinges = [e.tilt for e in file.rotors if e.tilt is not None]
    ids = [find_id(model, _OBJ.mjOBJ_JOINT, name, "rotors.tilt", folder) for name in hinges]
    angles = model.jnt_qposadr[ids]
    data.qpos[angles] = 0.0
    mujoco.mj_kinematics(model, data)
    rotors = tuple(_rotor(entry, i, model, data, base, folder) for i, entry in enumerate(file.rotors))
    _check_listing(rotors, folder)
    hover_thrust, hover_tilt = _hover(model, rotors, angles, folder)

    data.qpos[angles] = hover_tilt
    mujoco.mj_kinematics(model, data)
    R_WB, p_WB = data.xmat[base].reshape(3, 3), data.xpos[base]
    bodies = subtree(model, base)
    masses = model.body_mass[bodies]
    if masses.sum() <= 0 or (masses < 0).any():
        raise RobotError(plant, "mass", f"total is {masses.sum():g} kg", "give every body a mass > 0")
    mass, p_WC, J_W = lumped(model, data, bodies)
    p_BC = R_WB.T @ (p_WC - p_WB)
    p_BE, R_BE = np.zeros(3), np.eye(3)
    if file.robot.tool is not None:
        site = find_id(model, _OBJ.mjOBJ_SITE, file.robot.tool, "robot.tool", folder)
        p_BE = R_WB.T @ (data.site_xpos[site] - p_WB)
        R_BE = R_WB.T @ data.site_xmat[site].reshape(3, 3)
    imu = find_id(model, _OBJ.mjOBJ_SITE, file.robot.imu, "robot.imu", folder)
    sensor = file.sensors.force_torque
    arms = load_arms(file.arms, model, model.key(HOVER_KEYFRAME).id, folder)
    passive = load_passive(file.passive, model, folder)
    if not hinges:
        check_listing(arms, passive, model, bodies, folder)
    return Robot(
        folder=folder,
        file=file,
        mjmodel=model,
        base_id=base,
        mass=mass,
        p_BC=np.where(np.abs(p_BC) < 1e-14, 0.0, p_BC),
        J_C=R_WB.T @ J_W @ R_WB,
        rotors=rotors,
        has_tool=file.robot.tool is not None,
        p_BE=p_BE,
        R_BE=R_BE,
        p_BI=R_WB.T @ (data.site_xpos[imu] - p_WB),
        gravity=float(-model.opt.gravity[2]),
        hover_thrust=hover_thrust,
        hover_tilt=hover_tilt,
        force_torque=None if sensor is None else _force_torque(sensor.site, model, data, base, folder),
        arms=arms,
        passive=passive,
    )


def _hover(model: Any, rotors: tuple[Rotor, ...], angles: Array, folder: Path) -> tuple[Array, Array]:
    """Thrusts and tilt angles of the hover keyframe; `angles` are the tilts' addresses in qpos."""
    key = find_id(model, _OBJ.mjOBJ_KEY, HOVER_KEYFRAME, "hover keyframe", folder)
    ctrl, act, qpos = model.key_ctrl[key], model.key_act[key], model.key_qpos[key]
    thrusts = [rotor.index for rotor in rotors]
    servos = [rotor.tilt.index for rotor in rotors if rotor.tilt is not None]
    for kind, indices in (("rotors", thrusts), ("tilt servos", servos)):
        if not np.array_equal(act[model.actuator_actadr[indices]], ctrl[indices]):
            what = "hover thrusts" if kind == "rotors" else "hover angles"
            part, fault = "hover keyframe", f"act and ctrl of the {kind} differ"
            raise RobotError(folder / "plant.xml", part, fault, f"give both the {what}")
    if not np.array_equal(qpos[angles], ctrl[servos]):
        part, fault = "hover keyframe", "ctrl of the tilt servos and qpos of their joints differ"
        raise RobotError(folder / "plant.xml", part, fault, "give both the hover angles")
    return ctrl[thrusts].copy(), ctrl[servos].copy()
