"""Attitude and rate control of a robot whose rotors all push along z_B: the inner two of suarez2020's four loops.

    attitude, P:   w_c  = R_BBr w_r + K_q sigma,           sigma = chart of q_WB^-1 q_WB_r, in B
    rate, PID:     dw_c = K_w e + K_wi int e + K_wd de/dt,  e = w_c - w_B
    torque:        tau  = J dw_c + tau_r

J is what a torque has to turn (`Model.turning_inertia`). tau_r is the correction U_ext that the wrench estimator of
'General control framework' adds to the attitude controller's signal U_c. The paper gives the structure and no gains.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import hover_poses, numbers
from aerotact.gains import with_robot_gains
from aerotact.ports import Array, Block, BlockBuilder

SOURCE = "suarez2020"
NEEDS = ("thrust_and_torque", "fixed_rotors")


@dataclass(frozen=True)
class AttitudeReference:
    """What the inner loops follow.

    Attributes:
        lift: force along z_B, N, (1,).
        q_WB: attitude of the base.
        w_B: its angular velocity in its own axes, rad/s, (3,).
        tau_B: torque beyond what turns the base, N m in B, (3,).
    """

    lift: Any
    q_WB: Any
    w_B: Any
    tau_B: Any


def limited(vector: Any, longest: Any) -> Any:
    """A vector shortened to `longest` where it is longer; smooth at zero."""
    return vector * ca.fmin(1, longest / ca.sqrt(ca.sumsqr(vector) + 1e-12))


@dataclass(frozen=True)
class Pid:
    """Proportional, integral and derivative gains of one loop, (3,) each, and the integral's bound.

    `prefix` names the parameters <prefix>, <prefix>i, <prefix>d and <prefix>i_max.
    """

    prefix: str
    error_unit: str
    proportional: tuple[float, float, float]
    integral: tuple[float, float, float]
    derivative: tuple[float, float, float]
    integral_max: float

    def add(self, b: BlockBuilder, rate: float, error: Any, frame: str, cutoff: Any) -> Any:
        """Parameters, states and output, error unit/s, of the loop.

        The integral, in the output's unit, stops at its bound; the derivative is that of the error behind a first-order
        low-pass, K d/dt e -> K s/(1 + s/cutoff), at rest at the first step.

        Args:
            b: takes parameters and states.
            rate: Hz.
            error: (3,).
            frame: of error and gains.
            cutoff: rad/s.
        """
        name, unit = self.prefix, self.error_unit
        of_loop = f"of the {'angular velocity' if unit == 'rad/s' else 'velocity'}'s error"
        P = b.parameter(name, 3, "1/s", self.proportional, frame=frame, doc=f"gain {of_loop}", lower=0.0)
        K_i = b.parameter(f"{name}i", 3, "1/s^2", self.integral, frame=frame, doc=f"gain {of_loop}'s integral")
        K_d = b.parameter(f"{name}d", 3, "1", self.derivative, frame=frame, doc=f"gain {of_loop}'s derivative")
        bound = b.parameter(f"{name}i_max", 1, f"{unit}^2", self.integral_max, doc="bound of the integral", lower=0.0)
        total = b.state(f"{name}_integral", 3, f"{unit}^2", frame=frame, doc=f"integral part of the answer {of_loop}")
        low = b.state(f"{name}_low", 3, unit, frame=frame, doc="error behind the low-pass")
        started = b.state(f"{name}_started", 1, "1", kind="flag", doc="1 after the first step")
        before = ca.if_else(started > 0, low, error)
        b.update(f"{name}_integral", ca.fmin(ca.fmax(total + K_i * error / rate, -bound), bound))
        b.update(f"{name}_low", before + (1 - ca.exp(-cutoff / rate)) * (error - before))
        b.update(f"{name}_started", 1)
        return P * error + total + K_d * cutoff * (error - before)


RATE_LOOP = Pid("K_w", "rad/s", (20.0, 20.0, 6.0), (20.0, 20.0, 6.0), (0.0, 0.0, 0.0), 20.0)


def allocation_inverse(model: Model) -> Array:
    """Matrix (n, 4) from lift, N, and torque, N m in B, to the thrusts of least sum of squares.

    The torque is about the point that `model.rotor_wrench` takes.
    """
    thrust = ca.SX.sym("thrust", model.rotors)
    force, torque = model.rotor_wrench(thrust)
    columns = ca.jacobian(ca.vertcat(force[2], torque), thrust)
    return np.asarray(np.linalg.pinv(ca.DM(columns).full()))


def thrusts(model: Model, lift: Any, tau_B: Any) -> Any:
    """Thrusts, N, for lift and torque; where they leave their range the torque about z_B yields first.

    What still leaves the range is left to the limiter.
    """
    inverse, (lower, upper) = allocation_inverse(model), (ca.DM(v) for v in model.thrust_limits)
    level = ca.mtimes(ca.DM(inverse[:, :3]), ca.vertcat(lift, tau_B[0:2]))
    turning = ca.DM(inverse[:, 3]) * tau_B[2]
    room = ca.if_else(turning > 0, upper - level, level - lower)
    share = ca.mmin(ca.vertcat(room / ca.fmax(ca.fabs(turning), 1e-9), 1))
    return level + ca.fmax(share, 0) * turning


def add_attitude_loops(
    b: BlockBuilder, model: Model, rate: float, q_WB: Any, w_B: Any, r: AttitudeReference, tau_y: Any = None
) -> None:
    """Parameters, states and the output `thrust_cmd` of the attitude and rate loops; `tau_y`, if given, takes over."""
    K_q = b.parameter("K_q", 3, "1/s", (7.0, 7.0, 2.5), frame="B", doc="gain of the attitude's error", lower=0.0)
    fastest = b.parameter("w_max", 1, "rad/s", 3.0, doc="fastest rate that the attitude's error asks for", lower=0.0)
    cutoff = b.parameter("w_cutoff", 1, "rad/s", 120.0, doc="low-pass of the derivative of the rate's error", lower=0.0)
    R_BBr = ca.mtimes(so3.rotation(q_WB).T, so3.rotation(r.q_WB))
    w_c = ca.mtimes(R_BBr, r.w_B) + limited(K_q * so3.local(q_WB, r.q_WB), fastest)
    dw_c = RATE_LOOP.add(b, rate, w_c - w_B, "B", cutoff)
    J = ca.sparsify(ca.DM(np.where(np.abs(model.turning_inertia) < 1e-12, 0.0, model.turning_inertia)))
    tau_B = ca.mtimes(J, dw_c) + r.tau_B
    if tau_y is not None:
        tau_B[1] = tau_y
    thrust = thrusts(model, r.lift, tau_B)
    b.output("thrust_cmd", thrust, "N", doc="thrust commands", default=numbers(model.robot.hover_thrust))


def add_servos(b: BlockBuilder, model: Model) -> Any:
    """Reference of the arms' servos, which passes through; None without arms."""
    if "servo_cmd" not in model.commands:
        return None
    port = model.commands["servo_cmd"]
    return b.reference("servo_r", port.size, port.unit, doc="servo angles", default=port.default)


def suarez2020_attitude(model: Model, rate: float) -> Block:
    """Attitude and rate loops of an under-actuated robot, an inner controller: lift, attitude, torque in.

    Raises:
        MissingCapability: rotors tilt, or lift and torque cannot be changed independently.
    """
    model.require(NEEDS, "law suarez2020_attitude")
    b = BlockBuilder("suarez2020_attitude", SOURCE, rate, "attitude and rate loops, 'Aerial platform'")
    at = hover_poses(model)
    q_WB = b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion", default=at["q_WB"])
    w_B = b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base")
    force, torque = (numbers(ca.DM(part).full()) for part in model.rotor_wrench(ca.DM(model.robot.hover_thrust)))
    reference = AttitudeReference(
        lift=b.reference("lift_r", 1, "N", frame="B", doc="force along z_B", default=force[2:]),
        q_WB=b.reference("q_WB_r", 4, "1", frame="W", doc="attitude", kind="quaternion", default=at["q_WB"]),
        w_B=b.reference("w_B_r", 3, "rad/s", frame="B", doc="angular velocity, in the reference's own axes"),
        tau_B=b.reference("tau_B_r", 3, "N m", frame="B", doc="torque beyond what turns the base", default=torque),
    )
    servo = add_servos(b, model)
    add_attitude_loops(b, model, rate, q_WB, w_B, reference)
    finish(b, model, rate, servo)
    return with_robot_gains(b.build(), model.robot)


def finish(b: BlockBuilder, model: Model, rate: float, servo: Any) -> None:
    """The servos' command, if there are any, and the limiter."""
    if servo is not None:
        port = model.commands["servo_cmd"]
        b.output(port.name, servo, port.unit, doc=port.doc, default=port.default)
    b.limit_with(actuator_limiter(model, rate))


LAWS = {"suarez2020_attitude": suarez2020_attitude}
