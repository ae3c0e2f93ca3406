"""Rotors: the map from thrusts and tilt angles to the wrench on the body, and its inverse where rotors are fixed.

Each rotor pushes along its axis and drags about it: f_i = T_i a_i, tau_i = p_i x f_i + c_i T_i a_i
(ryll2019 (6)-(9), with T_i = c_f u_i). A hinge turns axis and position; by Rodrigues' formula both are sums of a
constant, a cosine and a sine of the angle, and so is the wrench of one newton, since (R r) x (R a) = R (r x a).
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from aerotact.ports import Array
from aerotact.robot import Robot

RANK_TOLERANCE = 1e-6


def tilting(robot: Robot) -> list[int]:
    """Numbers of the rotors that tilt, in their order: entry j of a tilt vector is of rotor `tilting(robot)[j]`."""
    return [i for i, rotor in enumerate(robot.rotors) if rotor.tilt is not None]


def allocation_parts(robot: Robot) -> tuple[Array, Array, Array]:
    """Matrices (6, n) A_0, A_c, A_s: the wrench is A_0 T + A_c (T cos(alpha)) + A_s (T sin(alpha)), entry by entry.

    It is [force, N; torque about the centre of mass, N m] in B. Of a rotor that does not tilt, all is in A_0; of one
    whose hinge is square to its thrust axis and passes through it, all but the hinge's own moment is in A_c and A_s.
    """
    parts = np.zeros((3, 6, len(robot.rotors)))
    for i, rotor in enumerate(robot.rotors):
        r, a, p_CH, h = rotor.p_BR - robot.p_BC, rotor.axis_B, np.zeros(3), None
        if rotor.tilt is not None:
            r, p_CH, h = rotor.p_BR - rotor.tilt.p_BH, rotor.tilt.p_BH - robot.p_BC, rotor.tilt.axis_B
        moment = np.cross(r, a) + rotor.drag * a
        for part, (a_part, moment_part) in enumerate(zip(_rodrigues(a, h), _rodrigues(moment, h), strict=True)):
            parts[part, :, i] = np.concatenate([a_part, np.cross(p_CH, a_part) + moment_part])
    parts[np.abs(parts) < 1e-14] = 0.0
    return parts[0], parts[1], parts[2]


def _rodrigues(v: Array, axis: Array | None) -> tuple[Array, Array, Array]:
    """v turned about a unit axis by alpha is the first + the second cos(alpha) + the third sin(alpha)."""
    if axis is None:
        return v, np.zeros(3), np.zeros(3)
    along = axis * (axis @ v)
    return along, v - along, np.cross(axis, v)


def allocation(robot: Robot, tilt: ArrayLike | None = None) -> Array:
    """Matrix (6, n) from thrusts, N, to [force; torque about the centre of mass], N and N m, in B.

    Args:
        robot: whose rotors.
        tilt: angles, rad, shape (m,); those of hover if None.
    """
    A_0, A_c, A_s = allocation_parts(robot)
    angle = _by_rotor(robot, robot.hover_tilt if tilt is None else np.asarray(tilt, dtype=float))
    return A_0 + A_c * np.cos(angle) + A_s * np.sin(angle)


def _by_rotor(robot: Robot, tilt: Array) -> Array:
    """Angle of every rotor, rad, zero for those that do not tilt."""
    angle = np.zeros(len(robot.rotors))
    angle[tilting(robot)] = tilt
    return angle


def wrench_jacobian(robot: Robot) -> Array:
    """Matrix (6, n + m): change of the wrench by thrusts, 1/N, and tilt angles, 1/rad, at hover."""
    _, A_c, A_s = allocation_parts(robot)
    angle = _by_rotor(robot, robot.hover_tilt)
    turned = (A_s * np.cos(angle) - A_c * np.sin(angle)) * robot.hover_thrust
    return np.hstack([allocation(robot), turned[:, tilting(robot)]])


def wrench_rank(robot: Robot) -> int:
    """Independent directions in which thrusts and tilts move the wrench at hover, relative to the largest."""
    singular = np.linalg.svd(wrench_jacobian(robot), compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def lift_and_torque_rank(robot: Robot) -> int:
    """The same of force along the base's z and torque alone: 4 is what a robot that tilts to move sideways needs."""
    singular = np.linalg.svd(wrench_jacobian(robot)[2:], compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def least_thrust_inverse(robot: Robot) -> Array:
    """Matrix (n, 6) from a wrench to the thrusts of least sum of squares (the inverse, if n = 6), all rotors fixed."""
    return np.asarray(np.linalg.pinv(allocation(robot)))


def least_thrust(robot: Robot, wrench: Any, tilt: Any = None) -> tuple[Any, Any]:
    """Thrusts of least sum of squares, N, and tilt angles, rad, that give a wrench; CasADi.

    For rotors that tilt, the unknowns are T cos(alpha) and T sin(alpha), in which the wrench is linear if the hinge is
    square to the thrust; the angle is the one nearest to `tilt` among those that differ by whole turns. Limits are not
    kept.

    Args:
        robot: whose rotors.
        wrench: [force, N; torque about the centre of mass, N m] in B, (6,).
        tilt: angles now, rad, (m,); those of hover if None.

    Returns:
        thrust (n,) and angles (m,).
    """
    A_0, A_c, A_s = allocation_parts(robot)
    tilts = tilting(robot)
    if not tilts:
        return ca.mtimes(ca.DM(least_thrust_inverse(robot)), wrench), ca.SX(0, 1)
    n = len(robot.rotors)
    now = ca.DM(robot.hover_tilt) if tilt is None else tilt
    parts = ca.mtimes(ca.DM(np.linalg.pinv(np.hstack([A_0 + A_c, A_s[:, tilts]]))), wrench)
    thrust, angles = [parts[i] for i in range(n)], []
    for j, i in enumerate(tilts):
        upward, sideways = parts[i], parts[n + j]
        thrust[i] = ca.sqrt(upward**2 + sideways**2 + 1e-12)
        off = ca.atan2(
            sideways * ca.cos(now[j]) - upward * ca.sin(now[j]), upward * ca.cos(now[j]) + sideways * ca.sin(now[j])
        )
        angles.append(now[j] + off)
    return ca.vertcat(*thrust), ca.vertcat(*angles)
