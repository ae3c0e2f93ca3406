"""Model: the symbolic equations of motion of a rigid aerial robot with lagging rotors, derived from its compiled MJCF.

State x:    p_WB(3) q_WB(4) v_WB(3) w_B(3) tilt(m) thrust(n); no tilt if m, the number of rotors that tilt, is zero
Control u:  tilt_rate(m) thrust_rate(n), the rates of the actual angles and thrusts; the command that causes them is
            angle or thrust + time_constant * u
Parameter p: f_ext_W(3), tau_ext_B(3): wrench of the environment on the robot at its centre of mass
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.rotors import allocation_parts, lift_and_torque_rank, tilting, wrench_rank
from aerotact.exceptions import InputError, MissingCapability
from aerotact.ports import Array, Layout, Port
from aerotact.robot import HOVER_KEYFRAME, Robot

CAPABILITIES = {
    "arm": "joints carry a tool",
    "fixed_rotors": "no rotor tilts",
    "force_torque": "a force/torque sensor carries the tool",
    "passive_joint": "there is a joint that nothing drives",
    "quasi_static": "joints of arms follow their servos, so that they can be predicted at rest",
    "rigid_body": "no joints, but for tilting rotors",
    "six_axis_wrench": "force and torque can be changed in all six directions at hover",
    "thrust_and_torque": "force along the base's z and torque can be changed independently at hover",
    "tilt": "rotors tilt",
    "tool": "a tool is named",
}


@dataclass(frozen=True)
class ActuatorLimits:
    """Of a group of lagging actuators; arrays of one length, in the unit of the group's port.

    Attributes:
        lower, upper: lowest and highest actual value.
        slowest, fastest: lowest and highest rate of the actual value, per second.
        time_constants: lags, s.
    """

    lower: Array
    upper: Array
    slowest: Array
    fastest: Array
    time_constants: Array


@dataclass(frozen=True)
class Model:
    """Named layouts, equations of motion, manifold and tool kinematics of one robot, as CasADi expressions."""

    robot: Robot

    @cached_property
    def state(self) -> Layout:
        """Layout of x."""
        return Layout(
            [
                Port("p_WB", 3, "m", "W", "position of the base"),
                Port("q_WB", 4, "1", "W", "attitude of the base", kind="quaternion"),
                Port("v_WB", 3, "m/s", "W", "velocity of the base"),
                Port("w_B", 3, "rad/s", "B", "angular velocity of the base"),
                *self.actuators,
            ]
        )

    @cached_property
    def actuators(self) -> Layout:
        """Layout of the part of x that the controls integrate: tilt (left out if nothing tilts), thrust."""
        robot = self.robot
        tilt = Port("tilt", self.tilts, "rad", "", "actual tilt angles", default=tuple(robot.hover_tilt))
        thrust = Port("thrust", self.rotors, "N", "", "actual thrusts", default=tuple(robot.hover_thrust))
        return Layout([tilt, thrust] if self.tilts else [thrust])

    @cached_property
    def control(self) -> Layout:
        """Layout of u."""
        tilt = Port("tilt_rate", self.tilts, "rad/s", "", "rates of the actual tilt angles")
        thrust = Port("thrust_rate", self.rotors, "N/s", "", "rates of the actual thrusts")
        return Layout([tilt, thrust] if self.tilts else [thrust])

    @cached_property
    def commands(self) -> Layout:
        """Layout of what is sent to the robot: thrust_cmd, tilt_cmd (left out if nothing tilts)."""
        robot = self.robot
        thrust = Port("thrust_cmd", self.rotors, "N", doc="thrust commands", default=tuple(robot.hover_thrust))
        tilt = Port("tilt_cmd", self.tilts, "rad", doc="tilt commands", default=tuple(robot.hover_tilt))
        return Layout([thrust, tilt] if self.tilts else [thrust])

    @cached_property
    def disturbance(self) -> Layout:
        """Layout of p."""
        return Layout(
            [
                Port("f_ext_W", 3, "N", "W", "force of the environment on the robot"),
                Port("tau_ext_B", 3, "N m", "B", "torque of the environment on the robot about its centre of mass"),
            ]
        )

    @property
    def rotors(self) -> int:
        """Number of rotors."""
        return len(self.robot.rotors)

    @property
    def tilts(self) -> int:
        """Number of rotors that tilt."""
        return len(self.robot.tilts)

    @property
    def tangent_size(self) -> int:
        """Coordinates of dx: one fewer than x, for the attitude."""
        return self.state.size - 1

    @cached_property
    def capabilities(self) -> frozenset[str]:
        """What laws and OCPs may need, of CAPABILITIES."""
        found = {"rigid_body", "tilt" if self.tilts else "fixed_rotors"}
        if wrench_rank(self.robot) == 6:
            found.add("six_axis_wrench")
        if lift_and_torque_rank(self.robot) == 4:
            found.add("thrust_and_torque")
        if self.robot.has_tool:
            found.add("tool")
        if self.robot.force_torque is not None:
            found.add("force_torque")
        return frozenset(found)

    def require(self, needs: tuple[str, ...] | list[str], who: str) -> None:
        """Check capabilities.

        Raises:
            MissingCapability: names who needs what, and what the robot has.
        """
        lacking = [n for n in needs if n not in self.capabilities]
        if lacking:
            raise MissingCapability(
                f"{who} needs {', '.join(lacking)}, which robot '{self.robot.name}' ({self.robot.folder}) lacks; "
                f"it has: {', '.join(sorted(self.capabilities)) or 'none'}"
            )

    @cached_property
    def hover_state(self) -> Array:
        """State x of the hover keyframe, shape (nx,), read-only."""
        mj = self.robot.mjmodel
        start = mj.jnt_qposadr[mj.body_jntadr[self.robot.base_id]]
        pose = mj.key(HOVER_KEYFRAME).qpos[start : start + 7]
        x = self.state.pack({"p_WB": pose[:3], "q_WB": pose[3:]})
        x.setflags(write=False)
        return x

    @cached_property
    def hover_tool(self) -> tuple[Array, Array]:
        """Tool pose at the hover keyframe: p_WE (3,) in m and q_WE (4,)."""
        x = ca.SX.sym("x", self.state.size)
        p_WE, q_WE = ca.Function("tool", [x], list(self.tool_pose(x)))(self.hover_state)
        return p_WE.full().ravel(), q_WE.full().ravel()

    # limits, of shape (n,) for thrusts and (m,) for tilts

    @cached_property
    def thrust_limits(self) -> tuple[Array, Array]:
        """Lowest and highest thrust, N."""
        lower, upper = zip(*(r.thrust for r in self.robot.rotors), strict=True)
        return np.array(lower), np.array(upper)

    @cached_property
    def thrust_rate_limits(self) -> tuple[Array, Array]:
        """Lowest and highest rate of the actual thrust, N/s."""
        lower, upper = zip(*(r.thrust_rate for r in self.robot.rotors), strict=True)
        return np.array(lower), np.array(upper)

    @cached_property
    def time_constants(self) -> Array:
        """Rotor lags, s."""
        return np.array([r.time_constant for r in self.robot.rotors])

    @cached_property
    def tilt_limits(self) -> tuple[Array, Array]:
        """Lowest and highest tilt angle, rad."""
        lower, upper = np.array([t.angle for t in self.robot.tilts]).reshape(-1, 2).T
        return lower, upper

    @cached_property
    def tilt_rate_limits(self) -> tuple[Array, Array]:
        """Lowest and highest rate of the actual tilt angle, rad/s."""
        lower, upper = np.array([t.rate for t in self.robot.tilts]).reshape(-1, 2).T
        return lower, upper

    @cached_property
    def tilt_time_constants(self) -> Array:
        """Lags of the tilt servos, s."""
        return np.array([t.time_constant for t in self.robot.tilts])

    @cached_property
    def actuator_time_constants(self) -> Array:
        """Lags in the order of the controls, s, shape (m + n,)."""
        return np.concatenate([self.tilt_time_constants, self.time_constants])

    @cached_property
    def actuator_limits(self) -> dict[str, ActuatorLimits]:
        """Limits by port of `actuators`."""
        limits = {"thrust": ActuatorLimits(*self.thrust_limits, *self.thrust_rate_limits, self.time_constants)}
        if self.tilts:
            limits["tilt"] = ActuatorLimits(*self.tilt_limits, *self.tilt_rate_limits, self.tilt_time_constants)
        return limits

    # equations

    @cached_property
    def _allocation(self) -> tuple[Any, Any, Any]:
        A_0, A_c, A_s = (ca.sparsify(ca.DM(part)) for part in allocation_parts(self.robot))
        turning = tilting(self.robot)
        return A_0, A_c[:, turning], A_s[:, turning]

    @cached_property
    def inverse_inertia(self) -> Any:
        """Inverse of the inertia about the centre of mass, 1/(kg m2), (3, 3)."""
        return ca.sparsify(ca.DM(_clean(np.linalg.inv(self.robot.J_C))))

    @cached_property
    def turning_inertia(self) -> Array:
        """Inertia (3, 3), kg m2, that a torque on the free base has to turn at hover, in B."""
        return self.robot.J_C

    def rotor_wrench(self, thrust: Any, tilt: Any = None) -> tuple[Any, Any]:
        """Force, N, and torque about the centre of mass, N m, of the rotors, in B; ryll2019 (8)-(9), and tilted.

        Args:
            thrust: N, (n,).
            tilt: rad, (m,); may be left out if nothing tilts.

        Raises:
            InputError: rotors tilt and no angles are given.
        """
        A_0, A_c, A_s = self._allocation
        wrench = ca.mtimes(A_0, thrust)
        if self.tilts:
            if tilt is None:
                raise InputError(f"rotor_wrench: no tilt angles; valid: {self.tilts} angles of '{self.robot.name}'")
            turned = thrust[tilting(self.robot)]
            wrench += ca.mtimes(A_c, turned * ca.cos(tilt)) + ca.mtimes(A_s, turned * ca.sin(tilt))
        return wrench[0:3], wrench[3:6]

    def accelerations(self, x: Any, p: Any) -> tuple[Any, Any]:
        """Newton-Euler about the centre of mass, ryll2019 (10), moved to the base's origin.

        Returns:
            a_WB (3,) m/s2 in W of the base's origin, and dw_B (3,) rad/s2 in B.
        """
        s, d = self.state.split(x), self.disturbance.split(p)
        R_WB = so3.rotation(s["q_WB"])
        f_B, tau_B = self.rotor_wrench(s["thrust"], s.get("tilt"))
        w, J, c = s["w_B"], ca.sparsify(ca.DM(_clean(self.robot.J_C))), ca.sparsify(ca.DM(_clean(self.robot.p_BC)))
        dw = ca.mtimes(self.inverse_inertia, tau_B + d["tau_ext_B"] - ca.cross(w, ca.mtimes(J, w)))
        a_WC = (ca.mtimes(R_WB, f_B) + d["f_ext_W"]) / self.robot.mass - ca.DM([0, 0, self.robot.gravity])
        a_WB = a_WC - ca.mtimes(R_WB, ca.cross(dw, c) + ca.cross(w, ca.cross(w, c)))
        return a_WB, dw

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """dx/dt for the rates u of tilts and thrusts and the external wrench p."""
        return self.state_rate(x, u, *self.accelerations(x, p))

    def state_rate(self, x: Any, u: Any, a_WB: Any, dw_B: Any) -> Any:
        """dx/dt for the rates u and given accelerations of the base, m/s2 in W and rad/s2 in B."""
        s = self.state.split(x)
        return ca.vertcat(s["v_WB"], so3.quaternion_rate(s["q_WB"], s["w_B"]), a_WB, dw_B, u)

    def command(self, x: Any, u: Any) -> Any:
        """Commands, laid out as `commands`, that give the rates u now: the inverse of the actuators' lags."""
        s, rate = self.state.split(x), self.control.split(u)
        thrust = s["thrust"] + ca.DM(self.time_constants) * rate["thrust_rate"]
        if not self.tilts:
            return thrust
        return ca.vertcat(thrust, s["tilt"] + ca.DM(self.tilt_time_constants) * rate["tilt_rate"])

    def rates(self, x: Any, command: Any) -> Any:
        """Rates u that commands, laid out as `commands`, cause now: the inverse of `command`."""
        s, sent = self.state.split(x), self.commands.split(command)
        rate = (sent["thrust_cmd"] - s["thrust"]) / ca.DM(self.time_constants)
        if not self.tilts:
            return rate
        return ca.vertcat((sent["tilt_cmd"] - s["tilt"]) / ca.DM(self.tilt_time_constants), rate)

    # manifold

    def retract(self, x: Any, dx: Any) -> Any:
        """x (+) dx with dx = [dp, sigma, dv, dw, dalpha, dT]; sigma as in dynamics.so3."""
        n = self.state.size
        return ca.vertcat(x[0:3] + dx[0:3], so3.retract(x[3:7], dx[3:6]), x[7:n] + dx[6 : n - 1])

    def local(self, x_from: Any, x_to: Any) -> Any:
        """dx with x_from (+) dx = x_to."""
        n = self.state.size
        return ca.vertcat(x_to[0:3] - x_from[0:3], so3.local(x_from[3:7], x_to[3:7]), x_to[7:n] - x_from[7:n])

    def at_rest(self, x: Any) -> Any:
        """x with zero velocities."""
        return ca.vertcat(x[0:7], ca.SX.zeros(6), x[13:])

    def sensed(self, x: Any) -> dict[str, Any]:
        """What sensors of joints say of x, by signal, without noise: nothing on a rigid body."""
        return {}

    # tool

    def tool_pose(self, x: Any) -> tuple[Any, Any]:
        """Tool position p_WE (3,), m, and attitude q_WE (4,)."""
        s = self.state.split(x)
        p_WE = s["p_WB"] + ca.mtimes(so3.rotation(s["q_WB"]), ca.DM(self.robot.p_BE))
        return p_WE, so3.product(s["q_WB"], ca.DM(self.q_BE))

    def tool_twist(self, x: Any) -> tuple[Any, Any]:
        """Tool velocity v_WE (3,), m/s in W, and angular velocity w_E (3,), rad/s in E."""
        s = self.state.split(x)
        v_WE = s["v_WB"] + ca.mtimes(so3.rotation(s["q_WB"]), ca.cross(s["w_B"], ca.DM(self.robot.p_BE)))
        return v_WE, ca.mtimes(ca.DM(_clean(self.robot.R_BE.T)), s["w_B"])

    @cached_property
    def q_BE(self) -> Array:
        """Attitude of the tool in B, wxyz."""
        return quaternion_from_matrix(self.robot.R_BE)

    def tool_jacobian(self, x: Any) -> Any:
        """Matrix (6, 6) from [v_WB; w_B] to [v_WE; w_E]."""
        twist = ca.vertcat(*self.tool_twist(x))
        return ca.jacobian(twist, x)[:, 7:13]

    @cached_property
    def function(self) -> Any:
        """CasADi function (x, u, p) -> dx/dt."""
        x, u, p = (ca.SX.sym(n, layout.size) for n, layout in zip("xup", self.layouts, strict=True))
        return ca.Function("f", [x, u, p], [self.derivative(x, u, p)], ["x", "u", "p"], ["xdot"])

    @property
    def layouts(self) -> tuple[Layout, Layout, Layout]:
        """Layouts of x, u and p."""
        return self.state, self.control, self.disturbance


def _clean(matrix: Array) -> Array:
    """Rounding dust removed, so that structural zeros are seen."""
    scale = np.abs(matrix).max() or 1.0
    return np.where(np.abs(matrix) < 1e-15 * scale, 0.0, matrix)


def quaternion_from_matrix(R: Array) -> Array:
    """Unit quaternion wxyz with w >= 0 of a rotation matrix."""
    # The eigenvector of the largest eigenvalue of a symmetric 4x4 matrix (Bar-Itzhack); well conditioned at any angle.
    K = np.empty((4, 4))
    K[0, 0] = np.trace(R)
    K[0, 1:] = K[1:, 0] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    q = np.linalg.eigh(K)[1][:, -1]
    q = np.where(np.abs(q) < 1e-15, 0.0, q)
    if q[0] < 0 or (q[0] == 0 and q[np.flatnonzero(q)[0]] < 0):
        q = -q
    return np.asarray(q / np.linalg.norm(q))
