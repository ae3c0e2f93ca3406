"""Plant: a robot in a world, stepped by MuJoCo, with tip friction and disturbances added.

`step` computes accelerations and integrates (mj_step2), then brings kinematics, contacts and velocities up to the new
state (mj_step1), so that `truth` is of one instant: poses, velocities and thrusts at `time`; forces and the rate of
thrust as they were over the step that led there. In `data.sensordata`, too, an accelerometer or a force sensor gives
the value over the last step, a gyro that of the new state.
"""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from aerotact.exceptions import InputError, LoopError, RobotError
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.joints import Joints
from aerotact.plant.servos import TiltServos
from aerotact.plant.tip import Tip
from aerotact.plant.world import attach_world
from aerotact.plant_file import mujoco_warnings
from aerotact.ports import Array
from aerotact.robot import HOVER_KEYFRAME, Robot

_OBJ = mujoco.mjtObj


def _vector(name: str, value: ArrayLike, size: int) -> Array:
    array = np.asarray(value, dtype=float)
    if array.shape != (size,) or not np.isfinite(array).all():
        raise InputError(f"{name} is {array.tolist()}; valid: {size} finite numbers")
    return array


def _spans(model: Any, body: int) -> tuple[slice, slice]:
    """Where the coordinates and the velocities of a body's joints lie in qpos and qvel."""
    last = model.body_jntadr[body] + model.body_jntnum[body]
    qpos = slice(model.jnt_qposadr[model.body_jntadr[body]], model.jnt_qposadr[last] if last < model.njnt else model.nq)
    return qpos, slice(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body])


class Plant:
    """The simulated robot.

    Attributes:
        robot: whose plant.xml it is.
        model: compiled `mujoco.MjModel` of robot and world.
        data: its `mujoco.MjData`; call `mujoco.mj_forward(model, data)` after writing into it.
        rng: of what disturbances draw; begins anew at each reset.
        tip: the end of the tool, its contacts and their friction.
        tips: that one, then those of the arms that `robot.tool` does not name.
        disturbances: those that act, in order; add by `disturb`.
        timestep: of the physics, s.
    """

    def __init__(
        self,
        robot: Robot,
        world: str | Path | None = None,
        *,
        timestep: float = 1e-3,
        disturbances: Iterable[Disturbance] = (),
        seed: int = 0,
    ) -> None:
        """Join robot and world and start at hover.

        Args:
            robot: a loaded robot.
            world: name or path of a world (see `aerotact.plant.world`); none is empty space.
            timestep: of the physics, s.
            disturbances: what acts on the plant.
            seed: of what the disturbances draw.

        Raises:
            UnknownName: no such world.
            InputError: a world that cannot be joined, a timestep out of range, a disturbance that does not fit.
            RobotError: the tip's geom has friction of its own, or a body with a joint has no name.
        """
        if not 1e-5 <= timestep <= 0.01:
            raise InputError(f"timestep is {timestep} s; valid: 1e-5 to 0.01 s")
        self.robot = robot
        self.timestep = timestep
        self._seed = seed
        self.rng = np.random.default_rng((seed, 1))  # not the sequence of the sensors with this seed
        self.model = self._compile(world)
        self.data = mujoco.MjData(self.model)
        self.disturbances: list[Disturbance] = []
        self._find_parts()
        self.tip = Tip(robot, self.model, self.data)
        others = [arm.tool for arm in robot.arms if arm.tool != robot.file.robot.tool]
        self.tips = (self.tip, *(Tip(robot, self.model, self.data, tool) for tool in others))
        self._order = [self._tip_of(arm.tool) for arm in robot.arms]
        self._warnings = self.data.warning.number
        self._xfrc = self.data.xfrc_applied
        self._pushed = False
        self._push_W = np.zeros((len(self.tips), 3))
        self._contact_W = np.zeros((len(self.tips), 3))
        for disturbance in disturbances:
            self.disturb(disturbance)
        self.reset()

    def _compile(self, world: str | Path | None) -> Any:
        file = self.robot.folder / "plant.xml"
        with mujoco_warnings():
            spec = mujoco.MjSpec.from_file(str(file))
            spec.option.timestep = self.timestep
            if world is not None:
                attach_world(spec, world)
            try:
                with warnings.catch_warnings():
                    warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
                    model = spec.compile()
            except ValueError as error:
                reason = str(error).strip().replace("\n", " ")
                raise InputError(f"{file} with world {world}: {reason}; valid: names not taken twice") from error
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        return model

    def _find_parts(self) -> None:
        """Ids and addresses by name: a world may have shifted them."""
        alone, model, names = self.robot.mjmodel, self.model, self.robot.file.robot
        key = mujoco.mj_name2id(alone, _OBJ.mjOBJ_KEY, HOVER_KEYFRAME)
        self.base_id: int = model.body(names.base).id
        self.imu_id: int = model.site(names.imu).id
        self._qpos = int(model.jnt_qposadr[model.body_jntadr[self.base_id]])
        self._qvel = int(model.jnt_dofadr[model.body_jntadr[self.base_id]])
        self._actuators = np.array([model.actuator(r.actuator).id for r in self.robot.rotors])
        self._thrusts = model.actuator_actadr[self._actuators]
        self.servos = TiltServos(self.robot, model, self.data)
        self.joints = Joints(self.robot, model, self.data)
        own = {alone.body(body).name for body in range(1, alone.nbody)}
        free = model.body_dofnum == 6
        self._objects = [int(i) for i in np.flatnonzero(free) if model.body(int(i)).name not in own]
        self._hover_qpos, self._hover_qvel = model.qpos0.copy(), np.zeros(model.nv)
        self._hover_act, self._hover_ctrl = np.zeros(model.na), np.zeros(model.nu)
        for body in np.flatnonzero(alone.body_jntnum):
            name = alone.body(body).name
            if not name:
                raise RobotError(self.robot.folder / "plant.xml", f"body {body}", "has a joint, no name", "name it")
            (qpos, qvel), (new_qpos, new_qvel) = _spans(alone, int(body)), _spans(model, model.body(name).id)
            self._hover_qpos[new_qpos] = alone.key_qpos[key, qpos]
            self._hover_qvel[new_qvel] = alone.key_qvel[key, qvel]
        for index in range(alone.nu):
            new = model.actuator(alone.actuator(index).name).id
            self._hover_ctrl[new] = alone.key_ctrl[key, index]
            if alone.actuator_actnum[index]:
                self._hover_act[model.actuator_actadr[new]] = alone.key_act[key, alone.actuator_actadr[index]]

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the world's free bodies, in the order of `objects_W` in `truth`."""
        return tuple(self.model.body(index).name for index in self._objects)

    def objects_seen(self) -> dict[str, Array]:
        """`objects_W` of `truth`; nothing if the world has no free bodies."""
        poses = [np.concatenate([self.data.xpos[i], self.data.xquat[i]]) for i in self._objects]
        return {"objects_W": np.concatenate(poses)} if poses else {}

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance.

        Raises:
            InputError: the robot cannot bear it.
        """
        disturbance.begin(self)
        self.disturbances.append(disturbance)

    def start_at(self, places: slice, coordinates: ArrayLike) -> None:
        """Let `reset` bring part of qpos to other values; for use by disturbances in `begin`."""
        self._hover_qpos[places] = coordinates

    def reset(self, p_WB: ArrayLike | None = None, q_WB: ArrayLike | None = None) -> None:
        """Back to time 0 and the hover keyframe, at rest, with the base moved where asked.

        Args:
            p_WB: position of the base, m, shape (3,).
            q_WB: attitude of the base, wxyz, shape (4,), of unit length to 1e-3.

        Raises:
            InputError: a pose that is not finite or of the wrong shape.
        """
        qpos = self._hover_qpos.copy()
        if p_WB is not None:
            qpos[self._qpos : self._qpos + 3] = _vector("p_WB", p_WB, 3)
        if q_WB is not None:
            q = _vector("q_WB", q_WB, 4)
            if abs(np.linalg.norm(q) - 1.0) > 1e-3:
                raise InputError(f"q_WB is {q.tolist()}; valid: a quaternion wxyz of unit length")
            qpos[self._qpos + 3 : self._qpos + 7] = q / np.linalg.norm(q)
        data = self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = qpos, self._hover_qvel
        data.act[:], data.ctrl[:] = self._hover_act, self._hover_ctrl
        self.servos.reset()
        self.joints.reset()
        for tip in self.tips:
            tip.reset()
        self.rng = np.random.default_rng((self._seed, 1))
        self._pushed = False
        self._push_W, self._contact_W = np.zeros((len(self.tips), 3)), np.zeros((len(self.tips), 3))
        mujoco.mj_forward(self.model, data)
        if data.ncon:
            for tip in self.tips:
                tip.read_normal_forces()

    def _tip_of(self, tool: str) -> int:
        """Place in `tips` of the tip at a site."""
        return [tip.site for tip in self.tips].index(self.model.site(tool).id)

    def command(self, thrust: ArrayLike, tilt: ArrayLike | None = None, servo: ArrayLike | None = None) -> None:
        """Set the commanded thrusts, tilt and servo angles; they hold until the next call. Beyond a range they are cut.

        Args:
            thrust: N, shape (n,), in the order of `robot.rotors`.
            tilt: rad, shape (m,), in the order of `robot.tilts`; None leaves the angles as they were commanded.
            servo: rad, shape (s,), of the arms' servos in the order of `robot.arms`; None leaves them likewise.

        Raises:
            InputError: wrong shape or not finite.
        """
        wanted = _vector("thrust", thrust, self._actuators.size)
        if tilt is not None:
            self.servos.command(_vector("tilt", tilt, len(self.robot.tilts)))
        if servo is not None:
            self.joints.command(_vector("servo", servo, len(self.joints.servos)))
        self.data.ctrl[self._actuators] = wanted

    def push(self, body: int, force_W: Array, p_WP: Array, torque_W: Array | None = None) -> None:
        """Let a force and a torque act on a body for the coming step; for use by disturbances.

        Args:
            body: id in `model`.
            force_W: N, shape (3,).
            p_WP: point of attack of the force in W, m, shape (3,).
            torque_W: N m, shape (3,).
        """
        fx, fy, fz = force_W.tolist()
        rx, ry, rz = (p_WP - self.data.xipos[body]).tolist()
        self._xfrc[body] += (fx, fy, fz, ry * fz - rz * fy, rz * fx - rx * fz, rx * fy - ry * fx)
        if torque_W is not None:
            self._xfrc[body, 3:] += torque_W
        self._pushed = True

    def push_tool(self, force_W: Array, offset_E: Array, arm: int | None = None) -> None:
        """Let a force act on a tool for the coming step; it counts in `f_tool_W` and `f_tools_W`.

        Args:
            force_W: N, shape (3,).
            offset_E: point of attack in E, m, shape (3,).
            arm: place in `robot.arms`; None is the tool that robot.toml names.
        """
        place = 0 if arm is None else self._order[arm]
        site = self.tips[place].site
        R_WE = self.data.site_xmat[site].reshape(3, 3)
        self.push(self.tips[place].body, force_W, self.data.site_xpos[site] + R_WE @ offset_E)
        self._push_W[place] += force_W

    def tool_point(self, arm: int) -> tuple[Array, Array]:
        """Position, m, and velocity, m/s, of a tool in W, shape (3,) each; `arm` is its place in `robot.arms`."""
        tip = self.tips[self._order[arm]]
        return self.data.site_xpos[tip.site].copy(), tip.velocity()[3:].copy()

    def step(self) -> None:
        """One step of the physics.

        Raises:
            LoopError: the state is not finite or MuJoCo warns or stops; names time and cause. `reset` mends it.
        """
        model, data = self.model, self.data
        if self._pushed:
            self._xfrc.fill(0.0)
            self._pushed = False
            self._push_W[:] = 0.0
        for disturbance in self.disturbances:
            disturbance.apply(self)
        self.servos.turn()
        self.joints.turn()
        try:
            if data.ncon and self.tip.geoms:
                self._step_in_contact()
            else:
                for place, tip in enumerate(self.tips):
                    if tip.normal_forces:
                        tip.reset()
                        self._contact_W[place] = 0.0
                mujoco.mj_step2(model, data)
            mujoco.mj_step1(model, data)
        except mujoco.FatalError as error:
            raise LoopError(f"plant stopped at {data.time:.4f} s: {error}") from error
        if self._warnings.any():
            kind = mujoco.mjtWarning(int(np.flatnonzero(self._warnings)[0])).name.removeprefix("mjWARN_")
            raise LoopError(
                f"plant stopped at {data.time:.4f} s: MuJoCo warns {kind}, so a force or the state has grown too far; "
                "check commands, gains and timestep"
            )

    def _step_in_contact(self) -> None:
        """Friction from the normal forces of the step before, then the step, then its normal forces."""
        found = [tip.contacts() for tip in self.tips]
        total = np.zeros((len(self.tips), 3))
        for place, (tip, contacts) in enumerate(zip(self.tips, found, strict=True)):
            for contact, force in zip(contacts, tip.friction_forces(contacts), strict=True):
                self.push(tip.body, force, contact.p_WC)
                if surface := tip.moving_body(contact):
                    self.push(surface, -force, contact.p_WC)
                total[place] += force
        mujoco.mj_step2(self.model, self.data)
        for place, (tip, contacts) in enumerate(zip(self.tips, found, strict=True)):
            tip.read_normal_forces()
            for contact in contacts:
                total[place] += tip.normal_forces[contact.key] * contact.n_W
        self._contact_W = total

    def base_pose(self) -> Array:
        """p_WB (m) and q_WB (wxyz) as one copy of shape (7,)."""
        return self.data.qpos[self._qpos : self._qpos + 7].copy()

    def thrust(self) -> Array:
        """Actual thrusts, N, shape (n,), in the order of `robot.rotors`."""
        return self.data.act[self._thrusts]

    def truth(self) -> dict[str, Array]:
        """What no sensor knows exactly, as copies.

        Returns:
            p_WB (m), q_WB (wxyz), v_WB (m/s, in W), w_B (rad/s, in B): the base;
            thrust (N), thrust_rate (N/s, at the start of the last step, where it is largest): shape (n,);
            tilt (rad), tilt_rate (rad/s): angles of the rotors about their hinges; tilt_rate_cmd (rad/s): what the
            command asked of the servos at the start of the last step, beyond their limits or not; shape (m,), left out
            if nothing tilts;
            joint (rad), joint_rate (rad/s): passive and arm joints, shape (k,); servo (rad): shafts of servos,
            shape (s,); p_tools_W (m) and f_tools_W (N): the arms' tools and the force of the environment on them,
            contact and disturbances, shape (3 arms,); left out if there are none;
            objects_W: position (m) and attitude (wxyz) of each free body of the world, shape (7 n,), likewise;
            p_WE (m), q_WE (wxyz), v_WE (m/s, in W): the tool, left out without one;
            f_tool_W: force of the environment on the tool, contact and disturbances, N;
            f_contact_W: the contact's part of it, normal force and friction, N.
        """
        data, q, v = self.data, self._qpos, self._qvel
        values = {
            "p_WB": data.qpos[q : q + 3].copy(),
            "q_WB": data.qpos[q + 3 : q + 7].copy(),
            "v_WB": data.qvel[v : v + 3].copy(),
            "w_B": data.qvel[v + 3 : v + 6].copy(),
            "thrust": self.thrust(),
            "thrust_rate": data.act_dot[self._thrusts],
            **self.servos.truth(),
            **self.joints.truth(),
        }
        values |= self.objects_seen()
        if self.tip.site >= 0:
            q_WE = np.zeros(4)
            mujoco.mju_mat2Quat(q_WE, data.site_xmat[self.tip.site])
            values["p_WE"] = data.site_xpos[self.tip.site].copy()
            values["q_WE"] = q_WE
            values["v_WE"] = self.tip.velocity()[3:].copy()
            values["f_tool_W"] = self._contact_W[0] + self._push_W[0]
            values["f_contact_W"] = self._contact_W[0].copy()
        if self._order:
            values["f_tools_W"] = (self._contact_W + self._push_W)[self._order].ravel()
        return values
