"""suarez2020_swing_regulator: the platform's loops with pitch and forward motion by one linear-quadratic regulator.

Not of the paper: beside its cascade, what full feedback of base and pendulum can do. Along the base's x with s = [e_x,
theta, q0, e_v, w_y, dq0/dt, tau, int e_x] (errors of position and speed along the heading, pitch less that of the
reference's acceleration, the pendulum's angle from hover, the torque behind the rotors' lag),

    tau_y = tau_r - K s,    K from the Riccati equation of the model at hover, the arms held.
"""

from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import solve_continuous_are

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion, add_base
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import RobotError
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.attitude import SOURCE, AttitudeReference, add_attitude_loops, add_servos, finish
from aerotact.laws.suarez2020.base import add_position_loops, reaction, swing_directions, with_arms
from aerotact.ports import Array, Block, BlockBuilder

WEIGHTS = (0.25, 0.0, 20.0, 0.5, 1.2, 0.2, 0.0, 0.07)
"""Of s squared, an integral in each unit; the torque's is 1 / (N m)^2."""
TORQUE_WEIGHT = 1.0
EXTRA_LAG = 0.006
"""s, of sampling and estimators, counted with the rotors'."""


def pitch_plane(model: Multibody) -> tuple[Array, Array]:
    """dx/dt = A x + B tau of x = [x, theta, q0, v, w_y, dq0/dt] at hover, arms held; m, rad, s, N m.

    With M of `dynamics.bodies` in [x, theta, q0] and the base's proper acceleration a_x - (-g theta) along its x,

        M [a_x - g theta; dw; ddq0] = [0; tau; -d dq0] - g (dM_z/dq0) q0.
    """
    rows, g = [0, 4, 6], model.robot.gravity
    q = ca.SX.sym("q", model.joints)
    mass = model.bodies.mass_matrix(q)
    f = ca.Function("f", [q], [mass[rows, rows], ca.jacobian(g * mass[rows, 2], q[0])])
    M, turned = (part.full() for part in f(model.hover_joint))
    inverse = np.linalg.inv(M)
    A, B = np.zeros((6, 6)), np.zeros(6)
    A[:3, 3:] = np.eye(3)
    A[3:, 2] = -(inverse @ turned)[:, 0]
    A[3:, 5] = -inverse[:, 2] * model.robot.passive[0].damping
    A[3, 1] += g
    B[3:] = inverse[:, 1]
    return A, B


def regulator(model: Multibody) -> tuple[Array, Array]:
    """Gain K (8,) and closed-loop matrix (8, 8) in s."""
    A, B = pitch_plane(model)
    lag = float(model.time_constants.max()) + EXTRA_LAG
    F, G = np.zeros((8, 8)), np.zeros(8)
    F[:6, :6], F[:6, 6] = A, B
    F[6, 6], G[6] = -1 / lag, 1 / lag
    F[7, 0] = 1.0
    P = solve_continuous_are(F, G[:, None], np.diag(WEIGHTS), [[TORQUE_WEIGHT]])
    K = G @ P / TORQUE_WEIGHT
    return K, F - np.outer(G, K)


def _add_pitch(
    b: BlockBuilder, model: Multibody, rate: float, base: BaseMotion, r: AttitudeReference, seen: Any
) -> Any:
    """Parameters, states and the torque about y_B."""
    joint, joint_rate, p_r, v_r, a_r, yaw_r = seen
    K = b.parameter("K_lqr", 8, "1", regulator(model)[0], doc="gain on s, N m by the units of s")
    far = b.parameter("error_max", 1, "m", 0.6, doc="largest error of position that counts", lower=0.0)
    strongest = b.parameter("torque_max", 1, "N m", 6.0, doc="largest torque of the regulator", lower=0.0)
    ahead = ca.vertcat(ca.cos(yaw_r), ca.sin(yaw_r))
    z = so3.rotation(base.q_WB)[:, 2]
    e_x = ca.dot(ahead, (base.p_WB - p_r)[0:2])
    e_x = ca.fmin(ca.fmax(e_x, -far), far)
    pitch = ca.atan2(ca.dot(ahead, z[0:2]), z[2]) - ca.dot(ahead, a_r[0:2]) / model.robot.gravity
    torque = b.state("pitch_torque", 1, "N m", doc="the regulator's torque behind the rotors' lag")
    total = b.state("position_integral", 1, "m s", doc="of the position's error")
    s = ca.vertcat(
        e_x,
        pitch,
        joint[0] - float(model.hover_joint[0]),
        ca.dot(ahead, (base.v_WB - v_r)[0:2]),
        base.w_B[1],
        joint_rate[0],
        torque,
        total,
    )
    asked = ca.fmin(ca.fmax(-ca.dot(K, s), -strongest), strongest)
    lag = float(model.time_constants.max()) + EXTRA_LAG
    b.update("pitch_torque", torque + (1 - float(np.exp(-1 / (rate * lag)))) * (asked - torque))
    b.update("position_integral", ca.fmin(ca.fmax(total + e_x / rate, -1), 1))
    hanging = ca.vertcat(ca.DM(model.hover_joint[:1]), joint[1:])
    return reaction(model, hanging, r.lift, ca.DM.zeros(3, len(model.robot.arms)))[1] + asked


def suarez2020_swing_regulator(model: Model, rate: float) -> Block:
    """Cascade in height, sideways and yaw, a linear-quadratic regulator in pitch and forward motion.

    Raises:
        MissingCapability: no arms or passive joint, or rotors that do not fit.
        RobotError: more than one passive joint, or one that does not swing along x.
    """
    law = "suarez2020_swing_regulator"
    model.require(["passive_joint"], f"law {law}")
    arms = with_arms(model, f"law {law}")
    if arms.passive != 1 or np.abs(swing_directions(arms)[:, 0] - [-1.0, 0.0, 0.0]).max() > 1e-6:
        raise RobotError(
            arms.robot.folder / "robot.toml", "passive.joints", "is no single joint about y", f"{law} needs one"
        )
    b = BlockBuilder(law, SOURCE, rate, "platform with a regulator of pitch, forward motion and swing")
    base = add_base(b, arms)
    reference, seen = add_position_loops(b, arms, rate, base)
    servo = add_servos(b, arms)
    tau_y = _add_pitch(b, arms, rate, base, reference, seen)
    add_attitude_loops(b, arms, rate, base.q_WB, base.w_B, reference, tau_y)
    finish(b, arms, rate, servo)
    return with_robot_gains(b.build(), arms.robot)


LAWS = {"suarez2020_swing_regulator": suarez2020_swing_regulator}
