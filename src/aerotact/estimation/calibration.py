"""Calibration: centre of mass and tool tip from logged flights and hand-held turns, by linear least squares.

bodie2021 (27)-(29) and 'Camera and Tool Frame Calibration'.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from aerotact.exceptions import InputError
from aerotact.ports import Array

WORST_CONDITION = 1e3


def centre_of_mass(f_B: ArrayLike, tau_B: ArrayLike) -> Array:
    """Centre of mass from the rotors' wrench in steady hover at various attitudes, (27)-(29).

    In hover the rotors' force goes through the centre of mass: p x f = tau. Each row gives the part of p across its
    force, so that rolling and pitching is needed.

    Args:
        f_B: rotors' forces in B, N, shape (N, 3).
        tau_B: their torques about a point in B, N m, shape (N, 3).

    Returns:
        Centre of mass from that point in B, m, shape (3,).

    Raises:
        InputError: shapes that do not fit, or attitudes too much alike.
    """
    forces, torques = _rows("f_B", f_B), _rows("tau_B", tau_B)
    if len(forces) != len(torques):
        raise InputError(f"f_B has {len(forces)} rows, tau_B {len(torques)}; valid: as many")
    X = np.concatenate([-_skew(f) for f in forces])
    return _least_squares(X, torques.ravel(), "f_B", "roll and pitch while hovering")


def tip_from_planes(n_C: ArrayLike, distance: ArrayLike) -> Array:
    """Tip of the tool in the camera's frame while it rests on a point of a plane and the robot is turned about it.

    The plane that the camera sees, n x = d, holds the tip.

    Args:
        n_C: unit normals of the plane seen, in the camera's frame C, shape (N, 3).
        distance: d, of the plane from the camera's origin along the normal, m, shape (N,).

    Returns:
        p_CE, m, shape (3,).

    Raises:
        InputError: shapes that do not fit, or turns about fewer than two axes.
    """
    normals, distances = _rows("n_C", n_C), np.asarray(distance, dtype=float).ravel()
    if len(normals) != len(distances):
        raise InputError(f"n_C has {len(normals)} rows, distance {len(distances)}; valid: as many")
    return _least_squares(normals, distances, "n_C", "turn about all three axes")


def tip_from_poses(p_WB: ArrayLike, q_WB: ArrayLike) -> tuple[Array, Array]:
    """Tip of the tool in B, from motion capture while it rests on a point and the robot is turned about it.

    p_WB + R_WB p_BE is the same point throughout.

    Args:
        p_WB: positions, m, shape (N, 3).
        q_WB: attitudes wxyz, shape (N, 4).

    Returns:
        p_BE and the point in W, m, shape (3,) each.

    Raises:
        InputError: shapes that do not fit, or turns about fewer than two axes.
    """
    positions, attitudes = _rows("p_WB", p_WB), _rows("q_WB", q_WB, 4)
    if len(positions) != len(attitudes):
        raise InputError(f"p_WB has {len(positions)} rows, q_WB {len(attitudes)}; valid: as many")
    R_WB = Rotation.from_quat(attitudes, scalar_first=True).as_matrix()
    X = np.concatenate([np.hstack([R, -np.eye(3)]) for R in R_WB])
    found = _least_squares(X, -positions.ravel(), "q_WB", "turn about all three axes")
    return found[:3], found[3:]


def _rows(name: str, values: ArrayLike, width: int = 3) -> Array:
    array = np.asarray(values, dtype=float)
    if array.ndim != 2 or array.shape[1] != width or not np.isfinite(array).all():
        raise InputError(f"{name} has shape {array.shape}; valid: (N, {width}), all finite")
    return array


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _least_squares(X: Array, y: Array, name: str, remedy: str) -> Array:
    """(X'X)^-1 X'y, as (28), computed stably."""
    found, _, rank, singular = np.linalg.lstsq(X, y, rcond=None)
    if rank < X.shape[1] or singular[0] > WORST_CONDITION * singular[-1]:
        raise InputError(f"{name}: its {len(X)} equations do not determine {X.shape[1]} numbers; valid: {remedy}")
    return np.asarray(found)
