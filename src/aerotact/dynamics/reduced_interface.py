"""The outside of a reduced predictor: layouts of its state, controls and commands, its place at hover, its limits."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody
from aerotact.dynamics.rotors import allocation
from aerotact.ports import Array, Layout, Port

# Shares of a rotor's headroom at hover: any total thrust and torque within the limits leave every rotor in its range.
_SHARE_THRUST = 0.2
_SHARE_TORQUE = (0.15, 0.15, 0.5)


@dataclass(frozen=True)
class ReducedInterface(Model):
    """What `Reduced` has besides equations.

    Attributes:
        full: the whole robot.
        arms: names of the working arms, in the order of `joint`; the first carries the force.
    """

    full: Multibody
    arms: tuple[str, ...]

    # layouts

    @cached_property
    def state(self) -> Layout:
        """Layout of x."""
        passive = [
            Port("passive", self.passive, "rad", "", "angles of the passive joints", default=self._hover_passive),
            Port("passive_rate", self.passive, "rad/s", "", "rates of the passive joints"),
        ]
        hover = tuple(self.full.hover_joint[self.full.passive :][self.working])
        return Layout(
            [
                Port("p_WB", 3, "m", "W", "position of the base"),
                Port("q_WB", 4, "1", "W", "attitude of the base", kind="quaternion"),
                Port("v_WB", 3, "m/s", "W", "velocity of the base"),
                Port("w_B", 3, "rad/s", "B", "angular velocity of the base"),
                *(passive if self.passive else ()),
                Port("joint", self.joints, "rad", "", "joint angles of the working arms", default=hover),
                Port("force", 1, "N", "", "force of the surface on the tool along its normal"),
            ]
        )

    @cached_property
    def actuators(self) -> Layout:
        """What lags its command, all servos: the limiter's state."""
        hover = tuple(self.full.hover_servo)
        return Layout([Port("servo", self.full.servos, "rad", "", "actual servo angles", default=hover)])

    @cached_property
    def control(self) -> Layout:
        """Layout of u."""
        return Layout(
            [
                Port("thrust", 1, "N", "B", "total thrust along z", default=(self.hover_thrust,)),
                Port("torque", 3, "N m", "B", "torque on the base, about its origin", default=tuple(self.hover_torque)),
                Port("joint_rate", self.joints, "rad/s", "", "rates of the joint angles"),
                Port("force_rate", 1, "N/s", "", "rate of the force"),
            ]
        )

    @cached_property
    def commands(self) -> Layout:
        """Layout of what is sent: references of the attitude law, and servo commands."""
        attitude = tuple(self.state.unpack(self.hover_state)["q_WB"])
        thrust, torque = (self.hover_thrust,), tuple(self.hover_torque)
        return Layout(
            [
                Port("lift_r", 1, "N", "B", "total thrust along z", default=thrust),
                Port("q_WB_r", 4, "1", "W", "attitude of the base", kind="quaternion", default=attitude),
                Port("w_B_r", 3, "rad/s", "B", "angular velocity of the base"),
                Port("tau_B_r", 3, "N m", "B", "torque on the base, about its origin", default=torque),
                Port("servo_r", self.full.servos, "rad", "", "servo angles", default=tuple(self.full.hover_servo)),
            ]
        )

    @cached_property
    def disturbance(self) -> Layout:
        """Layout of p."""
        return Layout(
            [
                Port("f_ext_W", 3, "N", "W", "force of the environment on the base, at its origin"),
                Port("tau_ext_B", 3, "N m", "B", "torque of the environment on the base, about its origin"),
                Port("n_W", 3, "1", "W", "normal of the surface that the tool touches, towards the robot"),
            ]
        )

    # parts

    @property
    def passive(self) -> int:
        """Number of passive joints."""
        return self.full.passive

    @cached_property
    def working(self) -> Array:
        """Where the working arms' joints stand in `servo`, shape (4 a,)."""
        return np.concatenate([np.arange(self.full.servos)[self.full.arm_slice(name)] for name in self.arms])

    @property
    def joints(self) -> int:
        """Number of joints of the working arms."""
        return len(self.working)

    @property
    def tools(self) -> int:
        """Coordinates of the working arms' tools."""
        return 3 * len(self.arms)

    @cached_property
    def elbows(self) -> list[int]:
        """Where each working arm's last joint stands in `joint`."""
        ends = np.cumsum([len(self.full.arm(name).joints) for name in self.arms])
        return [int(end) - 1 for end in ends]

    @cached_property
    def capabilities(self) -> frozenset[str]:
        """Those of the whole robot, and that arms follow quasi-statically."""
        return self.full.capabilities | {"quasi_static"}

    # hover

    @property
    def _hover_passive(self) -> tuple[float, ...]:
        return tuple(float(v) for v in self.full.hover_joint[: self.passive])

    @cached_property
    def hover_wrench(self) -> Array:
        """Force and torque about the base's origin of the rotors at hover, in B, shape (6,)."""
        return np.concatenate([v.full().ravel() for v in self.full.rotor_wrench(ca.DM(self.robot.hover_thrust))])

    @property
    def hover_thrust(self) -> float:
        """Total thrust at hover, N."""
        return float(self.hover_wrench[2])

    @property
    def hover_torque(self) -> Array:
        """Torque on the base at hover, N m in B, shape (3,)."""
        dust = np.abs(self.hover_wrench[3:]) < 1e-12 * self.hover_thrust
        return np.where(dust, 0.0, self.hover_wrench[3:])

    @property
    def hover_control(self) -> Array:
        """Control that holds the robot at hover, shape (nu,)."""
        return self.control.default

    # limits, as (lower, upper)

    @cached_property
    def _headroom(self) -> float:
        """Thrust by which every rotor can change at hover, N."""
        lower, upper = self.full.thrust_limits
        return float(np.minimum(self.robot.hover_thrust - lower, upper - self.robot.hover_thrust).min())

    @cached_property
    def thrust_limits(self) -> tuple[Array, Array]:
        """Lowest and highest total thrust, N, shape (1,); every rotor has room for any torque within its limits."""
        change = np.array([_SHARE_THRUST * self._headroom / np.abs(self.mixer[:, 0]).max()])
        return self.hover_thrust - change, self.hover_thrust + change

    @cached_property
    def torque_limits(self) -> Array:
        """Largest change of the torque from that of hover, N m in B, shape (3,)."""
        return np.array(_SHARE_TORQUE) * self._headroom / np.abs(self.mixer[:, 1:]).max(axis=0)

    @cached_property
    def mixer(self) -> Array:
        """Rotor thrusts (n, 4) for total thrust and torque: least squares."""
        matrix = allocation(self.robot)  # about the centre of mass
        torque = matrix[3:] + np.cross(self.robot.p_BC, matrix[:3], axisb=0, axisc=0)
        return np.asarray(np.linalg.pinv(np.vstack([matrix[2:3], torque])))

    @cached_property
    def joint_limits(self) -> tuple[Array, Array]:
        """Lowest and highest joint angles of the working arms, rad."""
        lower, upper = self.full.joint_limits
        return lower[self.working], upper[self.working]

    @cached_property
    def servo_limits(self) -> tuple[Array, Array]:
        """Lowest and highest servo angles of the working arms, rad."""
        lower, upper = self.full.servo_limits
        return lower[self.working], upper[self.working]

    @cached_property
    def servo_rate_limits(self) -> tuple[Array, Array]:
        """Lowest and highest servo rates of the working arms, rad/s."""
        lower, upper = self.full.servo_rate_limits
        return lower[self.working], upper[self.working]

    @cached_property
    def stiffness(self) -> Array:
        """Joint stiffnesses of the working arms, N m/rad."""
        return self.full.stiffness[self.working]
