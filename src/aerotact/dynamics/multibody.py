"""Multibody: the equations of motion of an aerial robot with compliant arms and passive joints, from its compiled MJCF.

State x:    p_WB(3) q_WB(4) v_WB(3) w_B(3) joint(m) joint_rate(m) servo(s) thrust(n); passive joints, then the arms'
Control u:  servo_rate(s) thrust_rate(n), the rates of the actual angles and thrusts, as in `Model`
Parameter p: f_ext_W(3) tau_ext_B(3): wrench of the environment on the base body at its origin; f_<arm>_W(3): force of
            the environment on each arm's tool

suarez2020 (8)-(13), mended: with nu = [a_B; dw_B; joint_acceleration] and M, c of `dynamics.bodies`,

    M nu + c = rotors + wrench on the base + sum J_tool' f_tool + joint torques,
    tau = k (servo - q) + d (servo_rate - q_rate) - bearing q_rate  (14), (15); a passive joint has the last term alone

and the servo's shaft is the first-order state of (17), not a body. Stops at the ends of a joint's range and the servo's
stall torque are limits, not part of the equations.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from aerotact.arms import Arm, CompliantJoint
from aerotact.dynamics import so3
from aerotact.dynamics.bodies import Bodies
from aerotact.dynamics.model import ActuatorLimits, Model
from aerotact.exceptions import UnknownName
from aerotact.ports import Array, Layout, Port
from aerotact.robot import HOVER_KEYFRAME


@dataclass(frozen=True)
class Multibody(Model):
    """The interface of `Model` for a robot with joints."""

    # layouts

    @cached_property
    def state(self) -> Layout:
        """Layout of x."""
        return Layout(
            [
                Port("p_WB", 3, "m", "W", "position of the base"),
                Port("q_WB", 4, "1", "W", "attitude of the base", kind="quaternion"),
                Port("v_WB", 3, "m/s", "W", "velocity of the base"),
                Port("w_B", 3, "rad/s", "B", "angular velocity of the base"),
                Port("joint", self.joints, "rad", "", "joint angles", default=tuple(self.hover_joint)),
                Port("joint_rate", self.joints, "rad/s", "", "rates of the joint angles"),
                *self.actuators,
            ]
        )

    @cached_property
    def actuators(self) -> Layout:
        """Layout of the part of x that the controls integrate."""
        return Layout(
            [
                Port("servo", self.servos, "rad", "", "actual servo angles", default=tuple(self.hover_servo)),
                Port("thrust", self.rotors, "N", "", "actual thrusts", default=tuple(self.robot.hover_thrust)),
            ]
        )

    @cached_property
    def control(self) -> Layout:
        """Layout of u."""
        return Layout(
            [
                Port("servo_rate", self.servos, "rad/s", "", "rates of the actual servo angles"),
                Port("thrust_rate", self.rotors, "N/s", "", "rates of the actual thrusts"),
            ]
        )

    @cached_property
    def commands(self) -> Layout:
        """Layout of what is sent to the robot."""
        hover = self.robot.hover_thrust
        return Layout(
            [
                Port("thrust_cmd", self.rotors, "N", doc="thrust commands", default=tuple(hover)),
                Port("servo_cmd", self.servos, "rad", doc="servo commands", default=tuple(self.hover_servo)),
            ]
        )

    @cached_property
    def disturbance(self) -> Layout:
        """Layout of p."""
        return Layout(
            [
                Port("f_ext_W", 3, "N", "W", "force of the environment on the base body, at its origin"),
                Port("tau_ext_B", 3, "N m", "B", "torque of the environment on the base body, about its origin"),
                *(
                    Port(f"f_{arm.name}_W", 3, "N", "W", f"force of the environment on the tool of arm '{arm.name}'")
                    for arm in self.robot.arms
                ),
            ]
        )

    # parts

    @cached_property
    def compliant(self) -> tuple[CompliantJoint, ...]:
        """The arms' joints, in the order of `servo`."""
        return tuple(joint for arm in self.robot.arms for joint in arm.joints)

    @property
    def passive(self) -> int:
        """Number of passive joints; they stand first in `joint`."""
        return len(self.robot.passive)

    @property
    def servos(self) -> int:
        """Number of servos."""
        return len(self.compliant)

    @property
    def joints(self) -> int:
        """Number of joints: passive ones and the arms'."""
        return self.passive + self.servos

    @cached_property
    def bodies(self) -> Bodies:
        """Mass matrix, velocity forces and frames."""
        return Bodies(self.robot)

    def arm(self, name: str) -> Arm:
        """An arm by name.

        Raises:
            UnknownName: no such arm.
        """
        found = {arm.name: arm for arm in self.robot.arms}
        if name not in found:
            raise UnknownName("arm", name, found, f"robot '{self.robot.name}'")
        return found[name]

    def arm_slice(self, name: str) -> slice:
        """Where the arm's joints lie in `servo`; in `joint` they stand `passive` further on."""
        start = 0
        for arm in self.robot.arms:
            if arm.name == name:
                return slice(start, start + len(arm.joints))
            start += len(arm.joints)
        raise UnknownName("arm", name, [arm.name for arm in self.robot.arms], f"robot '{self.robot.name}'")

    @cached_property
    def capabilities(self) -> frozenset[str]:
        """What laws and OCPs may need, of CAPABILITIES; never rigid_body."""
        found = set(super().capabilities) - {"rigid_body"}
        if self.robot.arms:
            found.add("arm")
        if self.robot.passive:
            found.add("passive_joint")
        return frozenset(found)

    # hover

    @cached_property
    def hover_joint(self) -> Array:
        """Joint angles of the hover keyframe, rad, shape (m,)."""
        model = self.robot.mjmodel
        addresses = [model.jnt_qposadr[j] for j in self.bodies.indices]
        return np.asarray(model.key(HOVER_KEYFRAME).qpos[addresses])

    @cached_property
    def hover_servo(self) -> Array:
        """Servo angles of the hover keyframe, rad, shape (s,)."""
        return np.array([self.robot.mjmodel.key(HOVER_KEYFRAME).ctrl[j.actuator_index] for j in self.compliant])

    # limits and constants, of shape (m,) for joints and (s,) for servos

    @cached_property
    def joint_limits(self) -> tuple[Array, Array]:
        """Lowest and highest angles of the arms' joints, rad, shape (s,)."""
        lower, upper = np.array([j.range for j in self.compliant]).reshape(-1, 2).T
        return lower, upper

    @cached_property
    def servo_limits(self) -> tuple[Array, Array]:
        """Lowest and highest servo angle, rad."""
        lower, upper = np.array([j.servo for j in self.compliant]).reshape(-1, 2).T
        return lower, upper

    @cached_property
    def servo_rate_limits(self) -> tuple[Array, Array]:
        """Lowest and highest servo rate, rad/s."""
        rate = np.array([j.servo_rate for j in self.compliant])
        return -rate, rate

    @cached_property
    def torque_limits(self) -> Array:
        """Stall torques, N m."""
        return np.array([j.torque for j in self.compliant])

    @cached_property
    def servo_time_constants(self) -> Array:
        """Servo lags, s."""
        return np.array([j.time_constant for j in self.compliant])

    @cached_property
    def actuator_time_constants(self) -> Array:
        """Lags in the order of the controls, s, shape (s + n,)."""
        return np.concatenate([self.servo_time_constants, self.time_constants])

    @cached_property
    def actuator_limits(self) -> dict[str, ActuatorLimits]:
        """Limits by port of `actuators`."""
        servo = ActuatorLimits(*self.servo_limits, *self.servo_rate_limits, self.servo_time_constants)
        return {**super().actuator_limits, "servo": servo}

    @cached_property
    def stiffness(self) -> Array:
        """Joint stiffnesses k, N m/rad."""
        return np.array([j.stiffness for j in self.compliant])

    @cached_property
    def damping(self) -> Array:
        """Joint dampings d, N m s/rad."""
        return np.array([j.damping for j in self.compliant])

    @cached_property
    def bearing_damping(self) -> Array:
        """Damping of all joints by their own rate, N m s/rad, shape (m,)."""
        return np.array([*(j.damping for j in self.robot.passive), *(j.bearing for j in self.compliant)])

    # equations

    def rotor_wrench(self, thrust: Any, tilt: Any = None) -> tuple[Any, Any]:
        """Force, N, and torque about the base's origin (the centre of mass moves), N m, of the rotors, in B."""
        force, torque = super().rotor_wrench(thrust, tilt)
        return force, torque + ca.cross(ca.DM(self.robot.p_BC), force)

    def joint_torque(self, x: Any, u: Any) -> Any:
        """Torque of spring and damper on each link, (15), N m, shape (s,)."""
        s, rate = self.state.split(x), self.control.split(u)["servo_rate"]
        deflection = s["servo"] - s["joint"][self.passive :]
        deflection_rate = rate - s["joint_rate"][self.passive :]
        return ca.DM(self.stiffness) * deflection + ca.DM(self.damping) * deflection_rate

    def tool_force_torques(self, x: Any, p: Any) -> Any:
        """Generalised force [f_B; tau_B; tau_joints] of the tool forces in p, shape (6 + m,)."""
        s, d = self.state.split(x), self.disturbance.split(p)
        R_WB, q = so3.rotation(s["q_WB"]), s["joint"]
        total = ca.DM.zeros(6 + self.joints)
        for arm in self.robot.arms:
            f_B = ca.mtimes(R_WB.T, d[f"f_{arm.name}_W"])
            tool = self.bodies.site(arm.tool_index, q)
            total += ca.vertcat(f_B, ca.cross(tool.p_BS, f_B), ca.mtimes(tool.J_v.T, f_B))
        return total

    def motion(self, x: Any, u: Any, p: Any) -> tuple[Any, Any, Any]:
        """Accelerations, suarez2020 (13).

        Returns:
            a_WB (3,) m/s2 in W of the base's origin, dw_B (3,) rad/s2 in B, and the joints' (m,) rad/s2.
        """
        s, d = self.state.split(x), self.disturbance.split(p)
        R_WB = so3.rotation(s["q_WB"])
        f_B, tau_B = self.rotor_wrench(s["thrust"])
        torque = ca.vertcat(ca.DM.zeros(self.passive), self.joint_torque(x, u))
        torque -= ca.DM(self.bearing_damping) * s["joint_rate"]
        forces = ca.vertcat(f_B + ca.mtimes(R_WB.T, d["f_ext_W"]), tau_B + d["tau_ext_B"], torque)
        forces += self.tool_force_torques(x, p)
        c = self.bodies.velocity_forces(s["joint"], s["w_B"], s["joint_rate"])
        nu = solve_from_the_leaves(self.bodies.mass_matrix(s["joint"]), forces - c)
        a_WB = ca.mtimes(R_WB, nu[0:3]) - ca.DM([0, 0, self.robot.gravity])
        return a_WB, nu[3:6], nu[6:]

    def accelerations(self, x: Any, p: Any) -> tuple[Any, Any]:
        """a_WB and dw_B as by `motion`, with the servos held."""
        a_WB, dw_B, _ = self.motion(x, ca.DM.zeros(self.control.size), p)
        return a_WB, dw_B

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """dx/dt for rates u of servos and thrusts and external forces p."""
        s = self.state.split(x)
        a_WB, dw_B, ddq = self.motion(x, u, p)
        turn = so3.quaternion_rate(s["q_WB"], s["w_B"])
        return ca.cse(ca.vertcat(s["v_WB"], turn, a_WB, dw_B, s["joint_rate"], ddq, u))

    def held_arms(self, q: Any) -> tuple[Any, Any]:
        """What the base has to move while the arms' servos hold and the passive joints are free, at joint angles q.

        With the passive joints eliminated from (13), M_bb a + M_bp dd_p = f_b and M_pb a + M_pp dd_p = f_p give

            (M_bb - M_bp M_pp^-1 M_pb) [a_B; dw_B] = f_b - M_bp M_pp^-1 f_p.

        Returns:
            the left matrix, (6, 6), and the factor of f_p, -M_bp M_pp^-1, (6, passive); forces in B about its origin.
        """
        M, n = self.bodies.mass_matrix(q), self.passive
        if not n:
            return M[0:6, 0:6], ca.DM.zeros(6, 0)
        passed = -ca.mtimes(M[0:6, 6 : 6 + n], ca.inv(M[6 : 6 + n, 6 : 6 + n]))
        return M[0:6, 0:6] + ca.mtimes(passed, M[6 : 6 + n, 0:6]), passed

    @cached_property
    def turning_inertia(self) -> Array:
        """Inertia (3, 3), kg m2, that a torque on the free base has to turn at hover, in B.

        The arms' joints are held and the passive ones free: what hangs on a passive joint resists a turn across its
        axis, and not about it.
        """
        M = ca.DM(self.held_arms(ca.DM(self.hover_joint))[0]).full()
        return np.asarray(M[3:, 3:] - M[3:, :3] @ np.linalg.solve(M[:3, :3], M[:3, 3:]))

    def gravity_torque(self, x: Any) -> Any:
        """Torques that hold the joints against gravity at rest, N m, shape (m,)."""
        s = self.state.split(x)
        up_B = so3.rotation(s["q_WB"])[2, :].T * self.robot.gravity
        return ca.mtimes(self.bodies.mass_matrix(s["joint"])[6:, 0:3], up_B)

    def holding_servo(self, x: Any, p: Any) -> Any:
        """Servo angles that hold the joint angles of x at rest under the tool forces of p, rad, shape (s,).

        The equivalent stiff-joint pose of suarez2020 'Kinematic model': q + (gravity_torque - J' f) / k.
        """
        load = self.gravity_torque(x) - self.tool_force_torques(x, p)[6:]
        return self.state.split(x)["joint"][self.passive :] + load[self.passive :] / ca.DM(self.stiffness)

    # commands

    def command(self, x: Any, u: Any) -> Any:
        """Commands, laid out as `commands`, that give the rates u now: the inverse of the lags, (17)."""
        s, rate = self.state.split(x), self.control.split(u)
        return ca.vertcat(
            s["thrust"] + ca.DM(self.time_constants) * rate["thrust_rate"],
            s["servo"] + ca.DM(self.servo_time_constants) * rate["servo_rate"],
        )

    def rates(self, x: Any, command: Any) -> Any:
        """Rates u that commands, laid out as `commands`, cause now: the inverse of `command`."""
        s, sent = self.state.split(x), self.commands.split(command)
        return ca.vertcat(
            (sent["servo_cmd"] - s["servo"]) / ca.DM(self.servo_time_constants),
            (sent["thrust_cmd"] - s["thrust"]) / ca.DM(self.time_constants),
        )

    def at_rest(self, x: Any) -> Any:
        """x with zero velocities."""
        s = self.state.split(x)
        rest = ca.DM.zeros(6), s["joint"], ca.DM.zeros(self.joints)
        return ca.vertcat(s["p_WB"], s["q_WB"], *rest, s["servo"], s["thrust"])

    def state_at(self, q_WB: Any, joint: Any) -> Any:
        """The hover state with another attitude and other joint angles."""
        x = ca.SX(ca.DM(self.hover_state))
        x[self.state.slice("q_WB")], x[self.state.slice("joint")] = q_WB, joint
        return x

    # sensors

    def sensed(self, x: Any) -> dict[str, Any]:
        """What the encoders of robot.toml say of x, without noise: deflection_measured (14), passive_measured, rad."""
        s, entries = self.state.split(x), self.robot.file.sensors
        links = dict(zip(self.bodies.joints, ca.vertsplit(s["joint"]), strict=True))
        shafts = dict(zip(self.bodies.joints[self.passive :], ca.vertsplit(s["servo"]), strict=True))
        said = {}
        if entries.deflection is not None:
            said["deflection_measured"] = ca.vertcat(*[shafts[j] - links[j] for j in entries.deflection.joints])
        if entries.passive is not None:
            said["passive_measured"] = ca.vertcat(*[links[j] for j in entries.passive.joints])
        return said

    # tools

    def arm_tool_pose(self, x: Any, arm: str) -> tuple[Any, Any]:
        """Position p_WE (3,), m, and attitude q_WE (4,) of an arm's tool."""
        return self._site_pose(x, self.arm(arm).tool_index)

    def tool_pose(self, x: Any) -> tuple[Any, Any]:
        """Position p_WE (3,), m, and attitude q_WE (4,) of the tool that `robot.tool` names."""
        return self._site_pose(x, self._tool)

    def tool_twist(self, x: Any) -> tuple[Any, Any]:
        """Tool velocity v_WE (3,), m/s in W, and angular velocity w_E (3,), rad/s in E."""
        s = self.state.split(x)
        twist = ca.mtimes(self.tool_jacobian(x), ca.vertcat(s["v_WB"], s["w_B"], s["joint_rate"]))
        return twist[0:3], twist[3:6]

    def tool_jacobian(self, x: Any) -> Any:
        """Matrix (6, 6 + m) from [v_WB; w_B; joint_rate] to [v_WE; w_E]."""
        s = self.state.split(x)
        R_WB, tool = so3.rotation(s["q_WB"]), self.bodies.site(self._tool, s["joint"])
        return ca.vertcat(
            ca.horzcat(ca.DM.eye(3), -ca.mtimes(R_WB, so3.skew(tool.p_BS)), ca.mtimes(R_WB, tool.J_v)),
            ca.horzcat(ca.DM.zeros(3, 3), so3.rotation(tool.q_BS).T, tool.J_w),
        )

    @cached_property
    def _tool(self) -> int:
        return int(self.robot.mjmodel.site(self.robot.file.robot.tool).id)

    def _site_pose(self, x: Any, site: int) -> tuple[Any, Any]:
        s = self.state.split(x)
        frame = self.bodies.site(site, s["joint"])
        return s["p_WB"] + ca.mtimes(so3.rotation(s["q_WB"]), frame.p_BS), so3.product(s["q_WB"], frame.q_BS)


def solve_from_the_leaves(M: Any, b: Any) -> Any:
    """M^-1 b, with the joints farthest from the base eliminated first: no fill-in between branches of the tree."""
    order = list(range(b.shape[0]))[::-1]
    D, L, permutation = ca.ldl(M[order, order], False)
    return ca.ldl_solve(b[order], D, L, permutation)[order]
