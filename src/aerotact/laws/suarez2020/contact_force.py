"""Force of an arm's tool from the deflection of its joints, and its control through the servos: (25)-(28), Fig. 17.

Forces are N in frame i, by the robot on the environment; deflections m; angles rad. Of an arm whose encoders see two
joints two components of the force can be told; the estimate is the least force that explains the torques, damped near
singular poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics.arm_kinematics import ArmKinematics
from aerotact.ports import BlockBuilder

DAMPING = 0.005
"""Singular values of the Jacobian, m, below which the least squares are damped."""

LEAST_FELT = 0.25
"""Share of a force's direction that the measured joints must feel for its size to be told."""


@dataclass(frozen=True)
class ForceGains:
    """Of the force controller.

    Attributes:
        force_p: proportional gain, 1: share of the force error that is answered by its deflection at once.
        force_i: integral gain, 1/s.
        force_speed: largest speed of the correction, m/s: how fast a tool without contact moves on.
        force_rate: rate of a force that no encoder measures, N/s.
    """

    force_p: Any
    force_i: Any
    force_speed: Any
    force_rate: Any


def add_force_gains(b: BlockBuilder) -> ForceGains:
    """Parameters; the paper gives no values. The zero of the two gains lies on the servo's lag of (17), 50 ms."""
    return ForceGains(
        force_p=b.parameter("force_p", 1, "1", 0.25, doc="proportional gain of the force error", lower=0.0),
        force_i=b.parameter("force_i", 1, "1/s", 5.0, doc="integral gain of the force error", lower=0.0),
        force_speed=b.parameter("force_speed", 1, "m/s", 0.1, doc="fastest correction of the force", lower=0.0),
        force_rate=b.parameter("force_rate", 1, "N/s", 4.0, doc="of a force that no encoder measures", lower=0.0),
    )


def cartesian_deflection(kinematics: ArmKinematics, theta: Any, q: Any) -> Any:
    """Tool of the equivalent stiff arm minus tool, (25), (3,)."""
    return kinematics.forward(theta) - kinematics.forward(q)


def force_of_deflection(kinematics: ArmKinematics, theta: Any, q: Any, up: Any, joints: Sequence[int]) -> Any:
    """Force on the environment, (3,), from the Cartesian deflection: (26), (27) mended.

    What gravity deflects is taken off first. J^-1 of (27), which brings the deflection back to the joints, is that of
    the mean Jacobian between the two poses (Simpson's rule); J^-T, the statics, that of the links.

    Args:
        kinematics: of the arm.
        theta: servo angles, (4,).
        q: joint angles, (4,); only those of `joints` count apart from theta.
        up: gravity's reaction in frame i, m/s2, (3,).
        joints: those whose deflection is measured.
    """
    chosen = list(joints)
    hanging = kinematics.gravity_torque(q, up) / ca.DM(kinematics.stiffness)
    loaded = ca.vertcat(*[q[j] + hanging[j] if j in chosen else theta[j] for j in range(4)])
    lengths = cartesian_deflection(kinematics, theta, loaded)
    poses = ((loaded, 1 / 6), ((theta + loaded) / 2, 4 / 6), (theta, 1 / 6))
    mean = sum((share * kinematics.jacobian(pose)[:, chosen] for pose, share in poses), ca.DM.zeros(3, len(chosen)))
    angles = ca.mtimes(_damped(ca.mtimes(mean.T, mean)), ca.mtimes(mean.T, lengths))
    torque = ca.DM(kinematics.stiffness[chosen]) * angles
    J = kinematics.jacobian(q)[:, chosen]
    return ca.mtimes(J, ca.mtimes(_damped(ca.mtimes(J.T, J)), torque))


def force_along(kinematics: ArmKinematics, q: Any, force: Any, direction: Any, joints: Sequence[int]) -> Any:
    """Size, N, of a force known to act along a unit direction, (3,), from the estimate of `force_of_deflection`.

    The estimate lacks what the measured joints do not feel; the direction's own share that they feel makes up for it.
    """
    J = kinematics.jacobian(q)[:, list(joints)]
    felt = ca.mtimes(J, ca.mtimes(_damped(ca.mtimes(J.T, J)), ca.mtimes(J.T, direction)))
    return ca.dot(direction, force) / ca.fmax(ca.dot(direction, felt), LEAST_FELT)


def compliance(kinematics: ArmKinematics, q: Any) -> Any:
    """J K_p^-1 J', m/N, (3, 3): the inverse of (27), which exists in singular poses too."""
    J = kinematics.jacobian(q)
    return ca.mtimes(J * ca.repmat(ca.DM(1.0 / kinematics.stiffness).T, 3, 1), J.T)


def force_corrections(
    gains: ForceGains, kinematics: ArmKinematics, q: Any, error: Any, period: float
) -> tuple[Any, Any]:
    """Shifts of the stiff arm's tool, m, (3,), for a force error, N, (3,): Delta r_F of Fig. 17 and (31).

    (26) turned about: a force is asked for by the deflection that belongs to it.

    Returns:
        What to add for good in this period, no faster than `force_speed`, and what to add for this period only.
    """
    lengths = ca.mtimes(compliance(kinematics, q), error)
    step = gains.force_i * period * lengths
    size = ca.sqrt(ca.sumsqr(step) + 1e-18)
    return step * ca.fmin(1, gains.force_speed * period / size), gains.force_p * lengths


def pushing_angles(kinematics: ArmKinematics, q: Any, force: Any) -> Any:
    """Deflections, rad, (4,), that belong to a force on the environment, N, (3,): for arms without encoders."""
    return ca.mtimes(kinematics.jacobian(q).T, force) / ca.DM(kinematics.stiffness)


def _damped(square: Any) -> Any:
    """Inverse of a symmetric matrix with DAMPING squared on its diagonal."""
    return ca.inv(square + DAMPING**2 * ca.DM.eye(square.shape[0]))
