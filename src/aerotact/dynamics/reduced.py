"""Reduced: a predictor of a robot with compliant arms, in which base and passive joints move by Newton and the working
arms follow their servos quasi-statically, so that it has none of the springs' stiff modes.

State x:    p_WB(3) q_WB(4) v_WB(3) w_B(3) passive(k) passive_rate(k) joint(4 a) force(1); joint: of the working arms,
            force: f of the surface on the tool, along its normal n_W; no passive, passive_rate on a robot without.
            v_WB, w_B, passive_rate are those that there were if the arms stopped now, see `recoil`
Control u:  thrust(1) torque(3) joint_rate(4 a) force_rate(1): total thrust along z of B, torque on the base about its
            origin, rates of the joint angles and of the force
Parameter p: f_ext_W(3), tau_ext_B(3): wrench of the environment on the base at its origin; n_W(3)

The arms' momentum is that of `recoil`; their own rates are left out of the centrifugal forces: what hangs on the
passive joint is one body, whose inertia follows from the mass matrix of `dynamics.bodies` for the arms as they stand,

    [F; tau; 0] = wrench of the base body + wrench of the hanging body, at the base, and about the passive axis,

and the arms' rows at rest give the servo angle as an output, the equivalent stiff-joint pose of suarez2020 'Kinematic
model': theta = q + K^-1 (gravity - J_tool' f n_W). Arms that do not work are locked at the angles of hover.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.inertia import Inertia
from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody, solve_from_the_leaves
from aerotact.dynamics.reduced_interface import ReducedInterface
from aerotact.dynamics.rotors import allocation
from aerotact.exceptions import MissingCapability, UnknownName
from aerotact.plant_file import joints_between, lumped, subtree
from aerotact.ports import Array

_DUST = 1e-15


@dataclass(frozen=True)
class Arms:
    """How the working arms stand.

    Attributes:
        hanging, tool: as `Reduced.hanging` and the first of `Reduced.tools_at_zero`.
        mass, coupling: rows of base and passive joint of the mass matrix, (6 + k, 6 + k) and (6 + k, 4 a).
    """

    hanging: Inertia
    tool: Any
    mass: Any
    coupling: Any


@dataclass(frozen=True)
class Reduced(ReducedInterface):
    """The interface of `Model` for prediction; made by `reduced_of`."""

    # equations

    def all_joints(self, x: Any) -> Any:
        """Angles of all joints of the robot, in the order of `Multibody`."""
        s = self.state.split(x)
        return self._joints(s["passive"] if self.passive else ca.SX(0, 1), s["joint"])

    def _joints(self, passive: Any, joint: Any) -> Any:
        arms = ca.SX(ca.DM(self.full.hover_joint[self.passive :]))
        arms[self.working.tolist()] = joint
        return ca.vertcat(passive, arms)

    @cached_property
    def carrier(self) -> Inertia:
        """What does not hang on the passive joint, a constant; nothing on a robot without one."""
        if not self.passive:
            return Inertia(0.0, ca.DM.zeros(3), ca.DM.zeros(3, 3))
        model, data = self.robot.mjmodel, mujoco.MjData(self.robot.mjmodel)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        below = subtree(model, int(model.jnt_bodyid[self.robot.passive[0].index]))
        bodies = [body for body in subtree(model, self.robot.base_id) if body not in below]
        mass, p_WC, inertia = lumped(model, data, bodies)
        R_WB = data.xmat[self.robot.base_id].reshape(3, 3)
        p_BC = R_WB.T @ (p_WC - data.xpos[self.robot.base_id])
        about_base = R_WB.T @ inertia @ R_WB + mass * (p_BC @ p_BC * np.eye(3) - np.outer(p_BC, p_BC))
        return Inertia(mass, ca.sparsify(ca.DM(mass * p_BC), _DUST), ca.sparsify(ca.DM(about_base), _DUST))

    @cached_property
    def hinge(self) -> tuple[Any, Any]:
        """Place p_BJ (3,), m, and axis (3,) of the passive joint in B."""
        model, data = self.robot.mjmodel, mujoco.MjData(self.robot.mjmodel)
        mujoco.mj_kinematics(model, data)
        joint, R_WB = self.robot.passive[0].index, data.xmat[self.robot.base_id].reshape(3, 3)
        p_BJ = R_WB.T @ (data.xanchor[joint] - data.xpos[self.robot.base_id])
        return ca.sparsify(ca.DM(p_BJ), _DUST), ca.sparsify(ca.DM(R_WB.T @ data.xaxis[joint]), _DUST)

    def hanging(self, joint: Any) -> Inertia:
        """What hangs on the passive joint, seen from there with the joint at zero: pendulum and all arms as one body.

        Without a passive joint, the whole robot seen from the base's origin.
        """
        M = self.full.bodies.mass_matrix(self._joints(ca.SX.zeros(self.passive), joint))
        whole = Inertia(self.robot.mass, ca.vertcat(M[5, 1], M[3, 2], M[4, 0]), ca.triu2symm(ca.triu(M[3:6, 3:6])))
        if not self.passive:
            return whole
        part = self.carrier
        mass, moment = whole.mass - part.mass, whole.moment - part.moment
        return Inertia(mass, moment, whole.inertia - part.inertia).seen_from(self.hinge[0])

    def tools_at_zero(self, joint: Any) -> list[Any]:
        """The working arms' tools in B with the passive joint at zero, (3,) each, m."""
        q = self._joints(ca.SX.zeros(self.passive), joint)
        return [self.full.bodies.site(self.full.arm(name).tool_index, q).p_BS for name in self.arms]

    def motion(self, x: Any, u: Any, p: Any, arms: Arms | None = None) -> tuple[Any, Any, Any]:
        """Accelerations: a_WB (3,) m/s2 in W of the base's origin, dw_B (3,) rad/s2 in B, the passive joint's rad/s2.

        Args:
            x, u, p: state, control, parameter.
            arms: as the working arms stand; None takes them from x.
        """
        arms = arms or self.arms_at(x)
        s, c, d = self.state.split(x), self.control.split(u), self.disturbance.split(p)
        R_WB, w = so3.rotation(s["q_WB"]), s["w_B"]
        f_B = ca.mtimes(R_WB.T, s["force"] * d["n_W"])
        at = self._swung(arms.tool, x)
        force = ca.vertcat(0, 0, c["thrust"]) + ca.mtimes(R_WB.T, d["f_ext_W"]) + f_B
        torque = c["torque"] + d["tau_ext_B"] + ca.cross(at, f_B)
        nu = ca.SX.sym("nu", 6 + self.passive)
        if self.passive:
            rate = s["passive_rate"]
            (p_BJ, axis), hung = self.hinge, self._turned(arms.hanging, x)
            f, tau = self.carrier.wrench(nu[0:3], w, nu[3:6])
            a_J = nu[0:3] + ca.cross(nu[3:6], p_BJ) + ca.cross(w, ca.cross(w, p_BJ))
            spin, spin_rate = w + axis * rate, nu[3:6] + axis * nu[6] + ca.cross(w, axis) * rate
            f_J, tau_J = hung.wrench(a_J, spin, spin_rate)
            bearing = float(self.full.bearing_damping[0]) * rate
            gap = ca.vertcat(
                f + f_J - force,
                tau + tau_J + ca.cross(p_BJ, f_J) - torque,
                ca.dot(axis, tau_J - ca.cross(at - p_BJ, f_B)) + bearing,
            )
        else:
            f, tau = arms.hanging.wrench(nu[0:3], w, nu[3:6])
            gap = ca.vertcat(f - force, tau - torque)
        at_zero = ca.substitute(gap, nu, ca.SX.zeros(nu.shape[0]))
        found = solve_from_the_leaves(ca.densify(ca.jacobian(gap, nu)), -at_zero)
        return ca.mtimes(R_WB, found[0:3]) - ca.DM([0, 0, self.robot.gravity]), found[3:6], found[6:]

    def arms_at(self, x: Any) -> Arms:
        """How the working arms of x stand."""
        joint, k = self.state.split(x)["joint"], 6 + self.passive
        M = self.full.bodies.mass_matrix(self.all_joints(x))
        moved = M[:k, [k + i for i in self.working.tolist()]]
        return Arms(self.hanging(joint), self.tools_at_zero(joint)[0], M[:k, :k], moved)

    def recoil(self, arms: Arms, joint_rate: Any) -> Any:
        """Velocity [v_B; w_B; passive] that base and passive joint lose while the arms move, (6 + k,).

        The velocities of the state are those with the arms stopped, M^-1 of the momentum: what stops the arms acts
        between bodies of the robot, so that joint rates may jump, and no acceleration of the arms is needed.
        """
        return solve_from_the_leaves(ca.densify(arms.mass), ca.mtimes(arms.coupling, joint_rate))

    def stopped(self, x: Any, joint_rate: Any) -> Any:
        """The state of a robot whose base and passive joint move as in x while the arms move."""
        s, lost = self.state.split(x), self.recoil(self.arms_at(x), joint_rate)
        s["v_WB"] = s["v_WB"] + ca.mtimes(so3.rotation(s["q_WB"]), lost[0:3])
        s["w_B"] = s["w_B"] + lost[3:6]
        if self.passive:
            s["passive_rate"] = s["passive_rate"] + lost[6:]
        return ca.vertcat(*[s[port.name] for port in self.state])

    def _swing(self, x: Any) -> Any:
        """Rotation by the passive joint's angle."""
        half, (_, axis) = self.state.split(x)["passive"] / 2, self.hinge
        return so3.rotation(ca.vertcat(ca.cos(half), axis * ca.sin(half)))

    def _turned(self, inertia: Inertia, x: Any) -> Inertia:
        R = self._swing(x)
        return Inertia(inertia.mass, ca.mtimes(R, inertia.moment), ca.mtimes([R, inertia.inertia, R.T]))

    def _swung(self, point: Any, x: Any) -> Any:
        """A point in B, given for a passive joint at zero."""
        if not self.passive:
            return point
        p_BJ, _ = self.hinge
        return p_BJ + ca.mtimes(self._swing(x), point - p_BJ)

    def accelerations(self, x: Any, p: Any) -> tuple[Any, Any]:
        """a_WB and dw_B as by `motion`, under the control of hover."""
        a_WB, dw_B, _ = self.motion(x, ca.DM(self.hover_control), p)
        return a_WB, dw_B

    def derivative(self, x: Any, u: Any, p: Any, arms: Arms | None = None) -> Any:
        """dx/dt for the controls u and the parameter p; `arms` as in `motion`."""
        arms = arms or self.arms_at(x)
        s, c = self.state.split(x), self.control.split(u)
        a_WB, dw_B, ddq = self.motion(x, u, p, arms)
        lost = self.recoil(arms, c["joint_rate"])
        v_WB = s["v_WB"] - ca.mtimes(so3.rotation(s["q_WB"]), lost[0:3])
        turn = so3.quaternion_rate(s["q_WB"], s["w_B"] - lost[3:6])
        swing = (s["passive_rate"] - lost[6:], ddq) if self.passive else ()
        return ca.vertcat(v_WB, turn, a_WB, dw_B, *swing, c["joint_rate"], c["force_rate"])

    def loads(self, x: Any, n_W: Any) -> Any:
        """Torques that hold passive joint and working arms at rest against gravity and force, N m, (k + 4 a,).

        The slope of the energy of weight and force in the joint angles.
        """
        s = self.state.split(x)
        R_BW, joint = so3.rotation(s["q_WB"]).T, s["joint"]
        angles = ca.SX.sym("angles", self.passive + self.joints)
        passive, arms = ca.vertsplit(angles, [0, self.passive, self.passive + self.joints])
        turned = ca.vertcat(x[0:13], passive, passive * 0, arms, s["force"]) if self.passive else x
        turned = turned if self.passive else ca.vertcat(x[0:13], arms, s["force"])
        M = self.full.bodies.mass_matrix(self._joints(ca.SX.zeros(self.passive), arms))
        moment = ca.vertcat(M[5, 1], M[3, 2], M[4, 0])
        if self.passive:
            p_BJ, _ = self.hinge
            part = self.carrier
            mass = self.robot.mass - part.mass
            moment = ca.mtimes(self._swing(turned), moment - part.moment - mass * p_BJ)
        tool = self._swung(self.tools_at_zero(arms)[0], turned)
        up_B = R_BW[:, 2] * self.robot.gravity
        f_B = ca.mtimes(R_BW, s["force"] * n_W)
        weight, push = ca.SX.sym("weight", 3), ca.SX.sym("push", 3)
        slope = ca.gradient(ca.dot(weight, moment) - ca.dot(push, tool), angles)
        here = ca.vertcat(s["passive"], joint) if self.passive else joint
        return ca.substitute(slope, ca.vertcat(angles, weight, push), ca.vertcat(here, up_B, f_B))

    def joint_torque(self, x: Any, n_W: Any) -> Any:
        """Torques of the working arms' springs at rest, N m, shape (4 a,)."""
        return self.loads(x, n_W)[self.passive :]

    def holding_servo(self, x: Any, n_W: Any) -> Any:
        """Servo angles of the working arms that hold x at rest, rad, shape (4 a,)."""
        return self.state.split(x)["joint"] + self.joint_torque(x, n_W) / ca.DM(self.stiffness)

    # commands

    def held_gain(self, period: float) -> Array:
        """Change of an integrated control per unit over one held command, s, shape (nu,).

        Less than the period for joints, whose servos lag.
        """
        tau = self.full.servo_time_constants[self.working]
        return self.control.pack(
            {"thrust": period, "torque": period, "joint_rate": -tau * np.expm1(-period / tau), "force_rate": period}
        )

    def command(self, x: Any, u: Any, p: Any = None, lead: Any = 0.0) -> Any:
        """Commands, laid out as `commands`, that bring about the controls u in x; servos that do not work hold hover.

        Args:
            x: state.
            u: controls.
            p: parameter; None is that of free flight without disturbance.
            lead: s by which attitude and angular velocity are those of later.
        """
        p = ca.DM(self.disturbance.pack({"n_W": [0, 0, -1]})) if p is None else p
        s, c, n_W = self.state.split(x), self.control.split(u), self.disturbance.split(p)["n_W"]
        slope = self.derivative(x, u, p)
        turning = s["w_B"] - self.recoil(self.arms_at(x), c["joint_rate"])[3:6]
        w_B = turning + lead * slope[self.state.slice("w_B")]
        q_WB = so3.unit(so3.retract(s["q_WB"], lead * (turning + w_B) / 2))
        servo = self.holding_servo(x, n_W)
        lag = ca.DM(self.full.servo_time_constants[self.working])
        servos = ca.SX(ca.DM(self.full.hover_servo))
        servos[self.working.tolist()] = servo + lag * ca.jtimes(servo, x, slope)
        return ca.vertcat(c["thrust"], q_WB, w_B, c["torque"], servos)

    def rates(self, x: Any, command: Any) -> Any:
        """Controls that commands, laid out as `commands`, cause now, with the servos at the static load of x."""
        sent = self.commands.split(command)
        servo = sent["servo_r"][self.working.tolist()] - self.holding_servo(x, ca.DM([0, 0, -1]))
        lag = ca.DM(self.full.servo_time_constants[self.working])
        return ca.vertcat(sent["lift_r"], sent["tau_B_r"], servo / lag, 0)

    # manifold

    def at_rest(self, x: Any) -> Any:
        """x with zero velocities."""
        s = self.state.split(x)
        swing = (s["passive"], ca.SX.zeros(self.passive)) if self.passive else ()
        return ca.vertcat(x[0:7], ca.SX.zeros(6), *swing, s["joint"], s["force"])

    # sensors

    def sensed(self, x: Any) -> dict[str, Any]:
        """What encoders and their estimator say of x at rest, without noise: as `Multibody.sensed`, and all joints."""
        s, full = self.state.split(x), self.full
        servos = ca.SX(ca.DM(full.hover_servo))
        servos[self.working.tolist()] = self.holding_servo(x, ca.DM([0, 0, -1]))
        joint, rate = self.all_joints(x), ca.SX.zeros(full.joints)
        if self.passive:
            rate[: self.passive] = s["passive_rate"]
        known = {"joint": joint, "servo": servos}
        rest = full.state.unpack(full.state.default)
        whole = ca.vertcat(*[known.get(name, ca.DM(value)) for name, value in rest.items()])
        return {**full.sensed(whole), "joint": joint, "joint_rate": rate}

    # tool

    def tool_pose(self, x: Any) -> tuple[Any, Any]:
        """Position p_WE (3,), m, and attitude q_WE (4,) of the first working arm's tool."""
        s = self.state.split(x)
        at = self._swung(self.tools_at_zero(s["joint"])[0], x)
        frame = self.full.bodies.site(self.full.arm(self.arms[0]).tool_index, self.all_joints(x))
        return s["p_WB"] + ca.mtimes(so3.rotation(s["q_WB"]), at), so3.product(s["q_WB"], frame.q_BS)

    def tool_twist(self, x: Any) -> tuple[Any, Any]:
        """Velocity v_WE (3,), m/s in W, and angular velocity w_E (3,), rad/s in E, of that tool with the arms still."""
        s, (_, q_WE) = self.state.split(x), self.tool_pose(x)
        swing = (s["passive_rate"], 0 * s["passive"]) if self.passive else ()
        slope = ca.vertcat(s["v_WB"], so3.quaternion_rate(s["q_WB"], s["w_B"]), ca.SX.zeros(6), *swing)
        spin_B = s["w_B"] + (self.hinge[1] * s["passive_rate"] if self.passive else 0)
        R_EB = ca.mtimes(so3.rotation(q_WE).T, so3.rotation(s["q_WB"]))
        rest = ca.SX.zeros(x.shape[0] - slope.shape[0])
        state = ca.SX.sym("x", x.shape[0])
        velocity = ca.jtimes(self.tool_pose(state)[0], state, ca.vertcat(slope, rest))
        return ca.substitute(velocity, state, x), ca.mtimes(R_EB, spin_B)

    def tool_positions(self, x: Any) -> Any:
        """Positions of all working arms' tools, m in W, one below the other, (3 a,)."""
        s = self.state.split(x)
        R_WB, points = so3.rotation(s["q_WB"]), self.tools_at_zero(s["joint"])
        return ca.vertcat(*[s["p_WB"] + ca.mtimes(R_WB, self._swung(point, x)) for point in points])

    def tool_jacobian(self, x: Any) -> Any:
        """Matrix (3, k + 4 a) from the rates of passive joint and working arms to the tool's velocity, in W."""
        site = self.full.bodies.site(self.full.arm(self.arms[0]).tool_index, self.all_joints(x))
        columns = [*range(self.passive), *(self.passive + self.working).tolist()]
        return ca.mtimes(so3.rotation(self.state.split(x)["q_WB"]), site.J_v[:, columns])


def reduced_of(model: Multibody, arms: list[str] | None = None) -> Reduced:
    """The predictor of a robot with arms.

    Args:
        model: the whole robot.
        arms: names of the working arms, that with the force first; None are all, the arm of `robot.tool` first.

    Raises:
        UnknownName: no such arm.
        MissingCapability: several passive joints, one that does not carry all arms, or rotors that do not push along z
            of the base.
    """
    if arms is None:
        tool = model.robot.file.robot.tool
        arms = [arm.name for arm in sorted(model.robot.arms, key=lambda arm: arm.tool != tool)]
    known = [arm.name for arm in model.robot.arms]
    for name in arms:
        if name not in known:
            raise UnknownName("arm", name, known, f"robot '{model.robot.name}'")
    carried = [
        joint.index in joints_between(model.robot.mjmodel, int(model.robot.mjmodel.jnt_bodyid[arm.joints[0].index]), 0)
        for joint in model.robot.passive
        for arm in model.robot.arms
    ]
    if len(model.robot.passive) > 1 or not all(carried):
        raise MissingCapability(
            f"prediction of robot '{model.robot.name}' ({model.robot.folder}): passive joints "
            f"{', '.join(joint.name for joint in model.robot.passive)}; valid: at most one, above all arms"
        )
    sideways = np.abs(allocation(model.robot)[:2]).max()
    if sideways > 1e-9:
        raise MissingCapability(
            f"prediction of robot '{model.robot.name}' ({model.robot.folder}): a rotor pushes sideways, "
            f"{sideways:.3g} N per newton; valid: rotors along z of the base"
        )
    return Reduced(model.robot, model, tuple(arms))


def predictor_of(model: Model, arms: list[str] | None = None) -> Model:
    """The model that a problem predicts with: itself, or `reduced_of` for a robot with arms.

    Raises:
        UnknownName, MissingCapability: as `reduced_of`; or arms are named and there are none.
    """
    if isinstance(model, Multibody) and model.robot.arms:
        return reduced_of(model, arms)
    if arms is not None:
        raise UnknownName("arm", arms[0], [], f"robot '{model.robot.name}'")
    return model
