"""Rotors: the linear map from thrusts to the wrench on the body, and its inverse.

Each rotor pushes along its axis and drags about it: f_i = T_i a_i, tau_i = p_i x f_i + c_i T_i a_i
(ryll2019 (6)-(9), with T_i = c_f u_i).
"""

import numpy as np

from aerotact.ports import Array
from aerotact.robot import Robot

RANK_TOLERANCE = 1e-6


def allocation(robot: Robot) -> Array:
    """Matrix (6, n) from thrusts, N, to [force; torque about the centre of mass], N and N m, in B."""
    columns = []
    for rotor in robot.rotors:
        torque = np.cross(rotor.p_BR - robot.p_BC, rotor.axis_B) + rotor.drag * rotor.axis_B
        columns.append(np.concatenate([rotor.axis_B, torque]))
    matrix = np.array(columns).T
    matrix[np.abs(matrix) < 1e-14] = 0.0
    return matrix


def allocation_rank(robot: Robot) -> int:
    """Independent directions of the wrench, singular values relative to the largest."""
    singular = np.linalg.svd(allocation(robot), compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def least_thrust_inverse(robot: Robot) -> Array:
    """Matrix (n, 6) from a wrench to the thrusts of least sum of squares (the inverse, if n = 6)."""
    return np.asarray(np.linalg.pinv(allocation(robot)))
