"""Tip: the geoms at the end of a robot's tool, what they touch, and the forces there."""

from typing import Any

import mujoco
import numpy as np

from aerotact.exceptions import RobotError
from aerotact.plant.tip_friction import Key, TipContact, TipFriction
from aerotact.ports import Array
from aerotact.robot import Robot


class Tip:
    """The colliding geoms of the body that carries the tool's site.

    Attributes:
        site: id of the tool's site, -1 without a tool.
        body: id of its body, -1 without a tool.
        geoms: ids of the body's geoms that collide.
        friction: state of the friction at the contacts.
        normal_forces: key of each contact of the last solution -> normal force on the tip, N.
    """

    def __init__(self, robot: Robot, model: Any, data: Any, tool: str | None = None) -> None:
        """Find the tip by name.

        Args:
            robot: whose tip it is.
            model: compiled plant.
            data: its state.
            tool: site at the tip; None is the robot's own tool.

        Raises:
            RobotError: a geom of the tip has friction of its own.
        """
        self._model, self._data = model, data
        self.friction = TipFriction()
        self.normal_forces: dict[Key, float] = {}
        self._velocity = np.zeros(6)
        self.site, self.body = -1, -1
        self.geoms: frozenset[int] = frozenset()
        if tool is None and not robot.has_tool:
            return
        self.site = int(model.site(tool or robot.file.robot.tool).id)
        self.body = int(model.site_bodyid[self.site])
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        self.geoms = frozenset(int(g) for g in np.flatnonzero((model.geom_bodyid == self.body) & collides))
        for geom in self.geoms:
            if model.geom_condim[geom] != 1 or model.geom_priority[geom] < 1:
                raise RobotError(
                    robot.folder / "plant.xml",
                    f"geom '{model.geom(geom).name}'",
                    f"has condim {model.geom_condim[geom]} and priority {model.geom_priority[geom]}",
                    'use condim="1" priority="1": the plant adds the friction of the tip',
                )

    def reset(self) -> None:
        """Forget friction and forces."""
        self.friction.reset()
        self.normal_forces = {}

    def velocity(self) -> Array:
        """Angular (rad/s) and linear (m/s) velocity of E in W, shape (6,); overwritten by the next call."""
        mujoco.mj_objectVelocity(self._model, self._data, mujoco.mjtObj.mjOBJ_SITE, self.site, self._velocity, 0)
        return self._velocity

    def contacts(self) -> list[TipContact]:
        """Where the tip touches now, with the normal forces of the last solution."""
        data, friction = self._data, self._model.geom_friction
        frames, points = data.contact.frame, data.contact.pos
        found = []
        for i, key, sign in self._touching():
            force = self.normal_forces.get(key, 0.0)
            p_WC, n_W = points[i].copy(), sign * frames[i, :3]
            v_WS = self._surface_velocity(key[1], p_WC)
            found.append(TipContact(key, p_WC, n_W, force, float(friction[key[1], 0]), v_WS))
        return found

    def moving_body(self, contact: TipContact) -> int:
        """Id of the body that carries the touched surface, 0 if it is at rest for good."""
        body = int(self._model.geom_bodyid[contact.key[1]])
        return body if self._model.body_weldid[body] else 0

    def _surface_velocity(self, geom: int, p_WC: Array) -> Array:
        body = int(self._model.geom_bodyid[geom])
        if not self._model.body_weldid[body]:
            return np.zeros(3)
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        return np.asarray(twist[3:] + np.cross(twist[:3], p_WC - self._data.xpos[body]))

    def friction_forces(self, contacts: list[TipContact]) -> list[Array]:
        """Advance the friction by one timestep of the model: its force on the tip in W at each contact, N."""
        velocity = self.velocity()
        p_WE = self._data.site_xpos[self.site]
        return self.friction.step(contacts, velocity[3:], velocity[:3], p_WE, self._model.opt.timestep)

    def read_normal_forces(self) -> None:
        """Take the normal forces from the solution of the constraints, before contacts are found anew."""
        rows, solved = self._data.contact.efc_address, self._data.efc_force
        self.normal_forces = {key: float(solved[rows[i]]) if rows[i] >= 0 else 0.0 for i, key, _ in self._touching()}

    def _touching(self) -> list[tuple[int, Key, float]]:
        """Number, key and sign of each contact of the tip; sign times MuJoCo's normal points to the tip."""
        found: list[tuple[int, Key, float]] = []
        counts: dict[tuple[int, int], int] = {}
        for i, (first, second) in enumerate(self._data.contact.geom.tolist()):
            if (first in self.geoms) == (second in self.geoms):
                continue
            pair, sign = ((second, first), 1.0) if second in self.geoms else ((first, second), -1.0)
            count = counts.get(pair, 0)
            counts[pair] = count + 1
            found.append((i, (*pair, count), sign))
        return found
