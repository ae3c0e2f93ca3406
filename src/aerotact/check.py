"""Check: the contract that a robot folder keeps, item by item, each with its remedy."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from aerotact.check_joints import joint_disagreement, joint_limit_fault, joint_trim
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.dynamics.rotors import allocation, lift_and_torque_rank, wrench_jacobian, wrench_rank
from aerotact.estimation import estimators
from aerotact.exceptions import AerotactError, RobotError
from aerotact.laws import laws
from aerotact.mpc.ocp import load_ocp
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.plant_file import lumped, subtree
from aerotact.ports import Array
from aerotact.resources import problem_files
from aerotact.robot import HOVER_KEYFRAME, Robot, load_robot

AGREEMENT = 1e-9  # m/s2 and rad/s2, between CasADi and MuJoCo
LUMPED = 0.02  # share of the inertia by which tilting may change it
SHIFT = 1e-3  # m, by which it may move the centre of mass
TRIM = 1e-9  # m/s2, rad/s2 and N/s at the hover keyframe
STATES = 200  # random states and commands
PHYSICS_RATE = 1000.0  # Hz
RATE_EXCESS = 10.0  # times what the lag allows, beyond which a thrust rate cannot be meant


@dataclass(frozen=True)
class Item:
    """One line of the contract.

    Attributes:
        name: what is checked.
        passed: it holds.
        detail: what was found, with its number; for a failure also file, part and remedy.
    """

    name: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Report:
    """What a check found; `fits` lists laws, estimators and problems, `misfits` says why others do not fit."""

    robot: str
    items: tuple[Item, ...]
    fits: tuple[str, ...]
    misfits: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Every item holds."""
        return all(item.passed for item in self.items)


def check_robot(name_or_path: str | Path, seed: int = 0) -> Report:
    """Check a robot folder; a folder that cannot be loaded gives a report with that one failed item.

    Raises:
        UnknownName: no such folder or robot.
    """
    try:
        robot = load_robot(name_or_path)
    except RobotError as error:
        return Report(str(name_or_path), (Item("loads without a MuJoCo warning", False, str(error)),), (), ())
    fits, misfits, faults = _fits(robot)
    items = [
        Item("loads without a MuJoCo warning", True, f"{robot.mass:.4g} kg, {len(robot.rotors)} rotors"),
        *_items(robot, seed),
        Item(
            "gains are parameters of their blocks", not faults, "; ".join(faults) or f"{len(robot.file.gains)} blocks"
        ),
    ]
    return Report(robot.name, tuple(items), tuple(fits), tuple(misfits))


def _items(robot: Robot, seed: int) -> Iterator[Item]:
    plant_xml, robot_toml = robot.folder / "plant.xml", robot.folder / "robot.toml"
    error = _trim_error(robot)
    yield _item(
        "hover keyframe is exact trim",
        error <= TRIM,
        f"largest acceleration {error:.1e}",
        f"{plant_xml}: keyframe '{HOVER_KEYFRAME}': make the pose level, at rest, {_trim_remedy(robot)}",
    )
    rank = wrench_rank(robot)
    if robot.arms:
        lifts = lift_and_torque_rank(robot)
        yield _item(
            "rotors lift and turn the base",
            lifts == 4,
            f"rank {lifts} of lift and torque, {rank} in all",
            f"{plant_xml}: rotor sites: place them around the base, with drag torques both ways",
        )
    else:
        yield _item(
            "allocation has rank 6",
            rank == 6,
            f"rank {rank}, condition {np.linalg.cond(wrench_jacobian(robot)):.1f}",
            f"{plant_xml}: rotor sites: tilt them so that force and torque are independent",
        )
    missing = _unlisted(robot)
    yield _item(
        "every actuator is listed",
        not missing,
        f"{robot.mjmodel.nu - len(missing)} of {robot.mjmodel.nu}",
        f"{robot_toml}: rotors or arms: add {', '.join(missing)}",
    )
    error = _disagreement(robot, np.random.default_rng(seed))
    yield _item(
        "CasADi accelerations equal MuJoCo's",
        error <= AGREEMENT,
        f"largest difference {error:.1e} over {STATES} random states and commands",
        f"{plant_xml}: leave out what the model has not: joints beside the free one (unless robot.toml lists them "
        "under arms or passive), fluid, springs, damping",
    )
    if robot.tilts:
        inertia, centre = _lump_changes(robot, np.random.default_rng(seed))
        yield _item(
            "tilting groups are light and balanced",
            inertia <= LUMPED and centre <= SHIFT,
            f"they change the inertia by {1e2 * inertia:.2g} % and move the centre of mass by {1e3 * centre:.2g} mm",
            f"{plant_xml}: put the centre of mass of each group on its hinge, and its mass near it; the model lumps "
            "all bodies as they stand in hover",
        )
    yield _limits(robot, robot_toml, plant_xml)
    try:
        sensors = Sensors(Plant(robot), robot, seed)
        rates = [sensors.imu_rate, sensors.mocap_rate, *sensors.joints.rates.values()]
        said = f"IMU {rates[0]:g} Hz, motion capture {rates[1]:g} Hz"
        camera = robot.file.sensors.depth_camera
        if camera:
            rates.append(camera.rate)
            said += f", depth camera {camera.rate:g} Hz"
        whole = all(abs(PHYSICS_RATE / r - round(PHYSICS_RATE / r)) < 1e-9 for r in rates)
        slower = max(rates[1:]) <= rates[0]
        yield _item(
            "sensors are there and their rates fit",
            whole and slower,
            said,
            f"{robot_toml}: sensors: choose rates that divide {PHYSICS_RATE:g} Hz, the IMU's the higher",
        )
    except AerotactError as failure:
        yield Item("sensors are there and their rates fit", False, str(failure))


def _item(name: str, passed: bool, detail: str, remedy: str) -> Item:
    return Item(name, passed, detail if passed else f"{detail}; {remedy}")


def _limits(robot: Robot, robot_toml: Path, plant_xml: Path) -> Item:
    name = "limits are consistent"
    for number, rotor in enumerate(robot.rotors):
        hover, (lower, upper) = robot.hover_thrust[number], rotor.thrust
        part = f"{plant_xml}: actuator '{rotor.actuator}'"
        if lower < 0:
            return Item(
                name, False, f"{part}: ctrlrange starts at {lower:g} N and a rotor does not pull; start at >= 0"
            )
        if not lower < hover < upper:
            return Item(
                name, False, f"{part}: hover needs {hover:.3g} N, ctrlrange is {lower:g} to {upper:g}; widen it"
            )
        rate, reach = max(np.abs(rotor.thrust_rate)), (upper - lower) / rotor.time_constant
        if rate > RATE_EXCESS * reach:
            return Item(
                name,
                False,
                f"{robot_toml}: rotors[{number}].thrust_rate: {rate:g} N/s is far beyond what a lag of "
                f"{rotor.time_constant:g} s allows, {reach:g} N/s; check its unit",
            )
    for tilt, hover in zip(robot.tilts, robot.hover_tilt, strict=True):
        part = f"{plant_xml}: actuator '{tilt.actuator}'"
        if not tilt.angle[0] < hover < tilt.angle[1]:
            lower, upper = tilt.angle
            return Item(
                name, False, f"{part}: hover needs {hover:.3g} rad, ctrlrange is {lower:g} to {upper:g}; widen it"
            )
        rate, reach = max(np.abs(tilt.rate)), (tilt.angle[1] - tilt.angle[0]) / tilt.time_constant
        if rate > RATE_EXCESS * reach:
            return Item(
                name,
                False,
                f"{robot_toml}: tilt_rate of '{tilt.joint}': {rate:g} rad/s is far beyond what a lag of "
                f"{tilt.time_constant:g} s allows, {reach:g} rad/s; check its unit",
            )
    fault = joint_limit_fault(robot, RATE_EXCESS)
    if fault:
        return Item(name, False, fault)
    margin = min(min(h - r.thrust[0], r.thrust[1] - h) for h, r in zip(robot.hover_thrust, robot.rotors, strict=True))
    return Item(name, True, f"smallest margin of thrust at hover {margin:.3g} N")


def _at(robot: Robot) -> mujoco.MjData:
    data = mujoco.MjData(robot.mjmodel)
    mujoco.mj_resetDataKeyframe(robot.mjmodel, data, robot.mjmodel.key(HOVER_KEYFRAME).id)
    return data


def _trim_error(robot: Robot) -> float:
    data = _at(robot)
    mujoco.mj_forward(robot.mjmodel, data)
    return float(np.abs(np.concatenate([data.qacc, data.act_dot, data.qvel])).max())


def _trim_remedy(robot: Robot) -> str:
    if not (robot.arms or robot.passive):
        return f'and set ctrl and act to "{_trim_thrust(robot)}"'
    activations, off = joint_trim(robot)
    balance = f"balance the passive joints, which lack {off:.2g} N m, " if off > TRIM else ""
    return f'{balance}and set ctrl and act to "{activations}"'


def _trim_thrust(robot: Robot) -> str:
    wrench = np.array([0, 0, robot.mass * robot.gravity, 0, 0, 0])
    thrust = np.linalg.lstsq(allocation(robot), wrench, rcond=None)[0]
    return " ".join(repr(float(t)) for t in thrust)


def _unlisted(robot: Robot) -> list[str]:
    listed = {r.index for r in robot.rotors} | {t.index for t in robot.tilts}
    listed |= {joint.actuator_index for arm in robot.arms for joint in arm.joints}
    return [robot.mjmodel.actuator(i).name or f"actuator {i}" for i in range(robot.mjmodel.nu) if i not in listed]


def _disagreement(robot: Robot, rng: np.random.Generator) -> float:
    """Largest difference of accelerations and of the actuators' rates over random states and commands.

    The model holds that a servo turns its rotor without a reaction on the body, and lumps the mass of all bodies as
    they stand in hover. So MuJoCo's hinges are held at rest, and its rotors push from their tilted places on the lump.
    """
    model, mj = model_of(robot), robot.mjmodel
    if isinstance(model, Multibody):
        return joint_disagreement(model, rng, STATES)
    data, tilted, f = _at(robot), _at(robot), model.function
    base = mj.body_jntadr[robot.base_id]
    q, v = mj.jnt_qposadr[base], mj.jnt_dofadr[base]
    hinges = [mj.joint(t.joint).id for t in robot.tilts]
    free = np.setdiff1d(np.arange(mj.nv), mj.jnt_dofadr[hinges])
    actuators = [*(t.index for t in robot.tilts), *(r.index for r in robot.rotors)]
    activations = mj.actuator_actadr[actuators]
    actual = {"tilt": model.tilt_limits, "thrust": model.thrust_limits}
    lower, upper = (np.concatenate(side) for side in zip(*actual.values(), strict=True))
    worst = 0.0
    for _ in range(STATES):
        attitude = rng.normal(size=4)
        x = model.state.pack(
            {
                "p_WB": rng.uniform([-2, -2, 8], [2, 2, 12]),
                "q_WB": attitude / np.linalg.norm(attitude),
                "v_WB": rng.normal(size=3),
                "w_B": 2 * rng.normal(size=3),
                **{port.name: rng.uniform(*actual[port.name]) for port in model.actuators},
            }
        )
        command = rng.uniform(lower, upper)
        push, turn = rng.normal(size=3), rng.normal(size=3)
        for d in (data, tilted):
            d.qpos[q : q + 7], d.qvel[v : v + 6] = x[:7], x[7:13]
            d.act[activations], d.ctrl[actuators] = x[13:], command
        data.xfrc_applied[robot.base_id] = _wrench_at_base(robot, x[3:7], push, turn)
        tilted.qpos[mj.jnt_qposadr[hinges]] = x[13 : 13 + model.tilts]
        mujoco.mj_forward(mj, data)
        mujoco.mj_forward(mj, tilted)
        force = data.qfrc_smooth + data.qfrc_constraint + tilted.qfrc_actuator - data.qfrc_actuator
        M = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, M)
        acceleration = np.zeros(mj.nv)
        acceleration[free] = np.linalg.solve(M[np.ix_(free, free)], force[free])
        rate = (command - x[13:]) / model.actuator_time_constants
        found: Array = f(x, rate, np.concatenate([push, turn])).full().ravel()
        difference = [found[7:13] - acceleration[v : v + 6], found[13:] - data.act_dot[activations]]
        worst = max(worst, float(np.abs(np.concatenate(difference)).max()))
    return worst


def _lump_changes(robot: Robot, rng: np.random.Generator) -> tuple[float, float]:
    """Largest change of the inertia, as a share of its smallest principal value, and of the centre of mass, m, that
    random tilt angles make."""
    mj, data = robot.mjmodel, _at(robot)
    angles = mj.jnt_qposadr[[mj.joint(t.joint).id for t in robot.tilts]]
    lower, upper = np.array([t.angle for t in robot.tilts]).T
    bodies = subtree(mj, robot.base_id)
    inertia = centre = 0.0
    for _ in range(STATES):
        data.qpos[angles] = rng.uniform(lower, upper)
        mujoco.mj_kinematics(mj, data)
        R_WB, p_WB = data.xmat[robot.base_id].reshape(3, 3), data.xpos[robot.base_id]
        _, p_WC, J_W = lumped(mj, data, bodies)
        change = np.linalg.norm(R_WB.T @ J_W @ R_WB - robot.J_C, 2) / np.linalg.eigvalsh(robot.J_C)[0]
        inertia = max(inertia, float(change))
        centre = max(centre, float(np.linalg.norm(R_WB.T @ (p_WC - p_WB) - robot.p_BC)))
    return inertia, centre


def _wrench_at_base(robot: Robot, q_WB: Array, f_W: Array, tau_B: Array) -> Array:
    """The wrench (f_W at the centre of mass, tau_B) as MuJoCo applies it: at the base body's own inertial frame."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, q_WB)
    R_WB = R.reshape(3, 3)
    lever_W = R_WB @ (robot.p_BC - robot.mjmodel.body_ipos[robot.base_id])
    return np.concatenate([f_W, R_WB @ tau_B + np.cross(lever_W, f_W)])


def _fits(robot: Robot) -> tuple[list[str], list[str], list[str]]:
    """What can be built for the robot, by name, why other things cannot, and which gains are wrong."""
    model, rate = model_of(robot), robot.file.sensors.imu.rate
    blocks, problems = laws() | estimators(), problem_files()
    fits: list[str] = []
    misfits: list[str] = []
    faults = [
        f"{robot.folder / 'robot.toml'}: gains.{name}: is no law and no estimator; valid: {', '.join(blocks)}"
        for name in robot.file.gains
        if name not in blocks
    ]
    for name in [*blocks, *problems]:
        try:
            if name in blocks:
                blocks[name](model, rate)
            else:
                load_ocp(name, model)
            fits.append(name)
        except RobotError as error:
            faults.append(str(error))
        except AerotactError as error:
            misfits.append(str(error))
    return fits, misfits, faults
