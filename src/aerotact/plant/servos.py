"""Servos: the tilt servos of a robot. Lag and angle range are plant.xml's; the rate limit, which MJCF lacks, is here.

A servo's activation is the angle of its shaft, s: ds/dt = (command - s)/tau, cut to the rate limit. A stiff spring
turns the rotor's hinge to s plus the play of the gear and the error of its zero, of which the servo's encoder knows
nothing.
"""

from typing import Any

import numpy as np

from aerotact.ports import Array
from aerotact.robot import Robot


class TiltServos:
    """The servos, in the order of `robot.tilts`; none if nothing tilts.

    Attributes:
        actuators: their ids in the model.
    """

    def __init__(self, robot: Robot, model: Any, data: Any) -> None:
        self._data, self._model, tilts = data, model, robot.tilts
        self.actuators = np.array([model.actuator(t.actuator).id for t in tilts], dtype=int)
        joints = np.array([model.joint(t.joint).id for t in tilts], dtype=int)
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._shafts = model.actuator_actadr[self.actuators]
        self._tau = np.array([t.time_constant for t in tilts])
        self._rates = np.array([t.rate for t in tilts]).reshape(-1, 2).T
        self._range = np.array([t.angle for t in tilts]).reshape(-1, 2).T
        # How far beyond the shaft the command may be for one timestep at full speed, under an exactly integrated lag.
        steps = model.opt.timestep / -np.expm1(-model.opt.timestep / self._tau)
        self._lead = self._rates * steps
        self._command = robot.hover_tilt.copy()
        self._wanted = np.zeros(len(tilts))
        self._start = robot.hover_tilt

    def reset(self) -> None:
        """Command the angles of hover, at rest."""
        self._command = self._start.copy()
        self._wanted = np.zeros(self._command.size)

    def command(self, tilt: Array) -> None:
        """Command angles, rad, shape (m,); beyond the range they are cut to it."""
        self._command = np.clip(tilt, *self._range)

    def turn(self) -> None:
        """Drive the shafts for the coming timestep."""
        if not self.actuators.size:
            return
        shaft = self._data.act[self._shafts]
        off = self._command - shaft
        self._wanted = off / self._tau
        self._data.ctrl[self.actuators] = shaft + np.minimum(np.maximum(off, self._lead[0]), self._lead[1])

    def shaft(self) -> Array:
        """Angles of the shafts, as the servos' encoders see them, rad, shape (m,)."""
        return self._data.act[self._shafts]

    def misalign(self, angle: Array) -> None:
        """Turn the rotors by `angle` (rad, shape (m,)) against the shafts."""
        model = self._model
        model.actuator_biasprm[self.actuators, 0] = model.actuator_gainprm[self.actuators, 0] * angle

    def truth(self) -> dict[str, Array]:
        """tilt (rad) and tilt_rate (rad/s) of the hinges, tilt_rate_cmd (rad/s), as Plant.truth has them."""
        if not self.actuators.size:
            return {}
        data = self._data
        return {"tilt": data.qpos[self._qpos], "tilt_rate": data.qvel[self._qvel], "tilt_rate_cmd": self._wanted}
