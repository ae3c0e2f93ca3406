"""Tilt allocation: a wrench -> thrusts and tilt angles of a robot whose rotors tilt, preferring where they point now.

Of a rotor that tilts, the unknowns are the components of its force along and across its present direction, in which the
wrench is linear. Minimising the sum of along^2 + across^2 / share over all rotors, subject to the wrench, is a weighted
pseudo-inverse. With share = 1 it is the plain one, of least sum of squared thrusts; with less, thrust is moved between
rotors rather than turned. Where the angles have come to rest there is no force across, and then the least-thrust
allocation is the only solution for any share: the weight changes the way and not the goal.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.model import Model
from aerotact.dynamics.rotors import allocation_parts, tilting
from aerotact.exceptions import MissingCapability

QUIET = 0.1  # of the highest thrust, below which an angle moves the less the smaller the thrust


@dataclass(frozen=True)
class Allocation:
    """Commands thrust (n,) N and tilt (m,) rad, and the wrench (6,) that rotors and servos can give within a lag."""

    thrust: Any
    tilt: Any
    reachable: Any


def _check_square_hinges(model: Model) -> None:
    """The wrench must be linear in the two components of each force."""
    constant = allocation_parts(model.robot)[0][:, tilting(model.robot)]
    if np.abs(constant).max(initial=0.0) > 1e-9:
        raise MissingCapability(
            f"tilt allocation needs six_axis_wrench linear in the rotors' forces, which robot '{model.robot.name}' "
            f"({model.robot.folder}) lacks: its hinges must be square to the thrust and on its line"
        )


def allocate(model: Model, wrench: Any, tilt: Any, share: Any) -> Allocation:
    """Thrusts and tilt angles for a wrench.

    The angle is the nearest to the present one, across +-pi too, and within the servo's range if a whole turn leads
    there. Near zero thrust it stays. While a servo cannot reach its angle within its lag, the rotor's thrust is the
    component of its force along the direction that it can reach.

    Args:
        model: of a robot with tilting rotors.
        wrench: wanted, [force, N; torque about the centre of mass, N m] in B, (6,).
        tilt: actual angles, rad, (m,).
        share: in (0, 1].

    Raises:
        MissingCapability: a hinge that is not square to its rotor's thrust, or not on its line.
    """
    _check_square_hinges(model)
    A_0, A_c, A_s = (ca.sparsify(ca.DM(part)) for part in allocation_parts(model.robot))
    turning = tilting(model.robot)
    fixed = [i for i in range(model.rotors) if i not in turning]
    cos, sin = ca.diag(ca.cos(tilt)), ca.diag(ca.sin(tilt))
    along = ca.mtimes(A_c[:, turning], cos) + ca.mtimes(A_s[:, turning], sin)
    across = ca.mtimes(A_s[:, turning], cos) - ca.mtimes(A_c[:, turning], sin)
    straight = A_0[:, fixed]

    multiplier = _solve(
        ca.mtimes(along, along.T) + share * ca.mtimes(across, across.T) + ca.mtimes(straight, straight.T), wrench
    )
    f_along, f_across = ca.mtimes(along.T, multiplier), share * ca.mtimes(across.T, multiplier)
    size = ca.sqrt(f_along**2 + f_across**2 + 1e-12)
    (lower, upper), highest = (ca.DM(v) for v in model.tilt_limits), model.thrust_limits[1]
    moving = ca.fmin(size / ca.DM(QUIET * highest[turning]), 1)
    angle = _within(tilt + moving * ca.atan2(f_across, f_along), lower, upper)

    slowest, fastest = (ca.DM(model.tilt_time_constants * rate) for rate in model.tilt_rate_limits)
    reached = ca.fmin(ca.fmax(angle - tilt, slowest), fastest)
    facing = ca.fmax(f_along * ca.cos(reached) + f_across * ca.sin(reached), 0)
    thrust = ca.SX(model.rotors, 1)
    thrust[turning], thrust[fixed] = facing, ca.mtimes(straight.T, multiplier)
    given = ca.fmin(ca.fmax(thrust, ca.DM(model.thrust_limits[0])), ca.DM(highest))
    return Allocation(thrust, angle, ca.vertcat(*model.rotor_wrench(given, tilt + reached)))


def _within(angle: Any, lower: Any, upper: Any) -> Any:
    """The angle, or the same a whole turn away where only that lies within the range; else the nearer end."""
    turned = angle - 2 * np.pi * (angle > upper) + 2 * np.pi * (angle < lower)
    inside = ca.logic_and(turned >= lower, turned <= upper)
    return ca.if_else(inside, turned, ca.fmin(ca.fmax(angle, lower), upper))


def _solve(A: Any, b: Any) -> Any:
    """Solution of A x = b for a symmetric positive definite A, by Cholesky without pivots."""
    n = A.shape[0]
    L, d = ca.SX.eye(n), [ca.SX(0)] * n
    for j in range(n):
        d[j] = A[j, j] - sum((L[j, k] ** 2 * d[k] for k in range(j)), ca.SX(0))
        for i in range(j + 1, n):
            L[i, j] = (A[i, j] - sum((L[i, k] * L[j, k] * d[k] for k in range(j)), ca.SX(0))) / d[j]
    x = [ca.SX(0)] * n
    for i in range(n):
        x[i] = b[i] - sum((L[i, k] * x[k] for k in range(i)), ca.SX(0))
    x = [x[i] / d[i] for i in range(n)]
    for i in reversed(range(n)):
        x[i] -= sum((L[k, i] * x[k] for k in range(i + 1, n)), ca.SX(0))
    return ca.vertcat(*x)
