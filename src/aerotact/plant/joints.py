"""Joints: arms and passive joints of a plant. Springs, lags and ranges are plant.xml's; what MJCF lacks is here.

A servo's activation is the angle of its shaft, theta: d theta/dt = (command - theta)/T_s, (17) of suarez2020, cut to
the servo's speed. MuJoCo's actuator gives k (theta - q) - d q_rate; the rest of (15), d theta_rate, is added here.
"""

from typing import Any

import numpy as np

from aerotact.ports import Array
from aerotact.robot import Robot


class Joints:
    """The joints of arms and the passive joints, in the order of `dynamics.multibody`; none on a rigid robot.

    Attributes:
        names: passive joints, then the arms' joints.
        servos: names of the arms' joints, which are those with a servo.
    """

    def __init__(self, robot: Robot, model: Any, data: Any) -> None:
        self._data = data
        compliant = [joint for arm in robot.arms for joint in arm.joints]
        self.servos = tuple(joint.name for joint in compliant)
        self.names = (*(joint.name for joint in robot.passive), *self.servos)
        ids = np.array([model.joint(name).id for name in self.names], dtype=int)
        self._qpos, self._qvel = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._links = self._qvel[len(robot.passive) :]
        self._actuators = np.array([model.actuator(j.actuator).id for j in compliant], dtype=int)
        self._shafts = model.actuator_actadr[self._actuators]
        self._sites = [model.site(arm.tool).id for arm in robot.arms]
        tau = np.array([j.time_constant for j in compliant])
        self._range = np.array([j.servo for j in compliant]).reshape(-1, 2).T
        self._damping = np.array([j.damping for j in compliant])
        # Mean rate over a timestep per angle that the command is ahead, under an exactly integrated lag.
        self._gain = -np.expm1(-model.opt.timestep / tau) / model.opt.timestep
        self._lead = np.array([j.servo_rate for j in compliant]) / self._gain
        key = robot.mjmodel.key("hover")
        self._start = np.array([key.ctrl[j.actuator_index] for j in compliant])
        self._command = self._start.copy()

    def reset(self) -> None:
        """Command the servo angles of hover."""
        self._command = self._start.copy()

    def command(self, servo: Array) -> None:
        """Command servo angles, rad, shape (s,); beyond a servo's range they are cut to it."""
        self._command = np.clip(servo, *self._range)

    def turn(self) -> None:
        """Drive the shafts for the coming timestep."""
        if not self.servos:
            return
        shaft = self._data.act[self._shafts]
        ahead = np.minimum(np.maximum(self._command - shaft, -self._lead), self._lead)
        self._data.ctrl[self._actuators] = shaft + ahead
        self._data.qfrc_applied[self._links] = self._damping * self._gain * ahead

    def angles(self) -> Array:
        """Angles of all joints, rad, shape (m,)."""
        return self._data.qpos[self._qpos]

    def shafts(self) -> Array:
        """Angles of the servos' shafts, rad, shape (s,)."""
        return self._data.act[self._shafts]

    def truth(self) -> dict[str, Array]:
        """What Plant.truth tells of joints; nothing on a rigid robot."""
        if not self.names:
            return {}
        values = {"joint": self.angles(), "joint_rate": self._data.qvel[self._qvel]}
        if self.servos:
            values["servo"] = self.shafts()
            values["p_tools_W"] = self._data.site_xpos[self._sites].ravel()
        return values
