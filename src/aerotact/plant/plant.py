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
from aerotact.plant.tip_friction import TipContact, TipFriction
from aerotact.plant.world import attach_world
from aerotact.ports import Array
from aerotact.robot import HOVER_KEYFRAME, Robot, mujoco_warnings

_OBJ = mujoco.mjtObj


def _vector(name: str, value: ArrayLike, size: int) -> Array:
    array = np.asarray(value, dtype=float)
    if array.shape != (size,) or not np.isfinite(array).all():
        raise InputError(f"{name} is {array.tolist()}; valid: {size} finite numbers")
    return array


class Plant:
    """The simulated robot.

    Attributes:
        robot: whose plant.xml it is.
        model: compiled `mujoco.MjModel` of robot and world.
        data: its `mujoco.MjData`; call `mujoco.mj_forward(model, data)` after writing into it.
        friction: friction state of the tip.
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
    ) -> None:
        """Join robot and world and start at hover.

        Args:
            robot: a loaded robot.
            world: name or path of a world (see `aerotact.plant.world`); none is empty space.
            timestep: of the physics, s.
            disturbances: what acts on the plant.

        Raises:
            UnknownName: no such world.
            InputError: a world that cannot be joined, a timestep out of range, a disturbance that does not fit.
            RobotError: the tip's geom has friction of its own, or a body with a joint has no name.
        """
        if not 1e-5 <= timestep <= 0.01:
            raise InputError(f"timestep is {timestep} s; valid: 1e-5 to 0.01 s")
        self.robot = robot
        self.timestep = timestep
        self.model = self._compile(world)
        self.data = mujoco.MjData(self.model)
        self.friction = TipFriction()
        self.disturbances: list[Disturbance] = []
        self._find_parts()
        self._find_tip()
        self._warnings = self.data.warning.number
        self._xfrc = self.data.xfrc_applied
        self._pushed = False
        self._push_W = np.zeros(3)
        self._contact_W = np.zeros(3)
        self._normal_forces: dict[tuple[int, int, int], float] = {}
        self._six = np.zeros(6)
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
        self.tool_id: int = model.site(names.tool).id if names.tool else -1
        self.imu_id: int = model.site(names.imu).id
        self._qpos = int(model.jnt_qposadr[model.body_jntadr[self.base_id]])
        self._qvel = int(model.jnt_dofadr[model.body_jntadr[self.base_id]])
        self._actuators = np.array([model.actuator(r.actuator).id for r in self.robot.rotors])
        self._thrusts = model.actuator_actadr[self._actuators]
        self._hover_qpos, self._hover_qvel = model.qpos0.copy(), np.zeros(model.nv)
        self._hover_act, self._hover_ctrl = np.zeros(model.na), np.zeros(model.nu)
        for body in np.flatnonzero(alone.body_jntnum):
            name = alone.body(body).name
            if not name:
                raise RobotError(self.robot.folder / "plant.xml", f"body {body}", "has a joint, no name", "name it")
            here, there = alone.body_jntadr[body], model.body_jntadr[model.body(name).id]
            for adr, nums, source, target in (
                ("jnt_qposadr", alone.nq, alone.key_qpos[key], self._hover_qpos),
                ("jnt_dofadr", alone.nv, alone.key_qvel[key], self._hover_qvel),
            ):
                start, last = getattr(alone, adr)[here], here + alone.body_jntnum[body]
                stop = getattr(alone, adr)[last] if last < alone.njnt else nums
                first = getattr(model, adr)[there]
                target[first : first + stop - start] = source[start:stop]
        for index in range(alone.nu):
            new = model.actuator(alone.actuator(index).name).id
            self._hover_ctrl[new] = alone.key_ctrl[key, index]
            if alone.actuator_actnum[index]:
                self._hover_act[model.actuator_actadr[new]] = alone.key_act[key, alone.actuator_actadr[index]]

    def _find_tip(self) -> None:
        """Geoms of the tool's body that collide; their contacts are the tip's."""
        model = self.model
        self._tip: frozenset[int] = frozenset()
        self._tool_body = -1
        if self.tool_id < 0:
            return
        self._tool_body = int(model.site_bodyid[self.tool_id])
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self._tip = frozenset(int(g) for g in np.flatnonzero((model.geom_bodyid == self._tool_body) & collides))
        for geom in self._tip:
            if model.geom_condim[geom] != 1 or model.geom_priority[geom] < 1:
                raise RobotError(
                    self.robot.folder / "plant.xml",
                    f"geom '{model.geom(geom).name}'",
                    f"has condim {model.geom_condim[geom]} and priority {model.geom_priority[geom]}",
                    'use condim="1" priority="1": the plant adds the friction of the tip',
                )

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
        self.friction.reset()
        self._pushed = False
        self._push_W, self._contact_W = np.zeros(3), np.zeros(3)
        mujoco.mj_forward(self.model, data)
        self._normal_forces = self._solved_normal_forces() if data.ncon else {}

    def command(self, thrust: ArrayLike) -> None:
        """Set the commanded thrusts; they hold until the next call. Beyond a rotor's range they are cut to it.

        Args:
            thrust: N, shape (n,), in the order of `robot.rotors`.

        Raises:
            InputError: wrong shape or not finite.
        """
        self.data.ctrl[self._actuators] = _vector("thrust", thrust, self._actuators.size)

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

    def push_tool(self, force_W: Array, offset_E: Array) -> None:
        """Let a force act on the tool for the coming step; it counts in `f_tool_W`.

        Args:
            force_W: N, shape (3,).
            offset_E: point of attack in E, m, shape (3,).
        """
        R_WE = self.data.site_xmat[self.tool_id].reshape(3, 3)
        self.push(self._tool_body, force_W, self.data.site_xpos[self.tool_id] + R_WE @ offset_E)
        self._push_W = self._push_W + force_W

    def step(self) -> None:
        """One step of the physics.

        Raises:
            LoopError: the state is not finite or MuJoCo warns or stops; names time and cause. `reset` mends it.
        """
        model, data = self.model, self.data
        if self._pushed:
            self._xfrc.fill(0.0)
            self._pushed = False
            self._push_W = np.zeros(3)
        for disturbance in self.disturbances:
            disturbance.apply(self)
        try:
            if data.ncon:
                self._step_in_contact()
            else:
                if self._normal_forces:
                    self._leave_contact()
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
        contacts = self.contacts()
        mujoco.mj_objectVelocity(self.model, self.data, _OBJ.mjOBJ_SITE, self.tool_id, self._six, 0)
        p_WE = self.data.site_xpos[self.tool_id]
        forces = self.friction.step(contacts, self._six[3:], self._six[:3], p_WE, self.timestep)
        total = np.zeros(3)
        for contact, force in zip(contacts, forces, strict=True):
            self.push(self._tool_body, force, contact.p_WC)
            total += force
        mujoco.mj_step2(self.model, self.data)
        self._normal_forces = self._solved_normal_forces()
        for contact in contacts:
            total += self._normal_forces[contact.key] * contact.n_W
        self._contact_W = total

    def _leave_contact(self) -> None:
        self._normal_forces = {}
        self._contact_W = np.zeros(3)
        self.friction.reset()

    def contacts(self) -> list[TipContact]:
        """Where the tip touches now, with the normal forces of the step before."""
        data, friction = self.data, self.model.geom_friction
        frames, points = data.contact.frame, data.contact.pos
        found = []
        for i, key, sign in self._touching():
            normal, force = sign * frames[i, :3], self._normal_forces.get(key, 0.0)
            found.append(TipContact(key, points[i].copy(), normal, force, float(friction[key[1], 0])))
        return found

    def _touching(self) -> list[tuple[int, tuple[int, int, int], float]]:
        """Number, key and sign of each contact of the tip; sign times MuJoCo's normal points to the tip."""
        found: list[tuple[int, tuple[int, int, int], float]] = []
        counts: dict[tuple[int, int], int] = {}
        for i, (first, second) in enumerate(self.data.contact.geom.tolist()):
            if (first in self._tip) == (second in self._tip):
                continue
            pair, sign = ((second, first), 1.0) if second in self._tip else ((first, second), -1.0)
            count = counts.get(pair, 0)
            counts[pair] = count + 1
            found.append((i, (*pair, count), sign))
        return found

    def _solved_normal_forces(self) -> dict[tuple[int, int, int], float]:
        """Key of each contact -> normal force on the tip in the last solution, N."""
        rows, solved = self.data.contact.efc_address, self.data.efc_force
        return {key: float(solved[rows[i]]) if rows[i] >= 0 else 0.0 for i, key, _ in self._touching()}

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
        }
        if self.tool_id >= 0:
            q_WE, velocity = np.zeros(4), np.zeros(6)
            mujoco.mju_mat2Quat(q_WE, data.site_xmat[self.tool_id])
            mujoco.mj_objectVelocity(self.model, data, _OBJ.mjOBJ_SITE, self.tool_id, velocity, 0)
            values["p_WE"] = data.site_xpos[self.tool_id].copy()
            values["q_WE"] = q_WE
            values["v_WE"] = velocity[3:]
            values["f_tool_W"] = self._contact_W + self._push_W
            values["f_contact_W"] = self._contact_W.copy()
        return values
