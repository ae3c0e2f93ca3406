"""ContactPose: how the tool, and with it the base, stands on a surface, bodie2021 (40)-(46) as in docs/errata.md."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.exceptions import InputError
from aerotact.ports import Array

_UP = np.array([0.0, 0.0, 1.0])
_LEVEL = 0.02  # sine of the angle to the vertical below which a normal gives no horizontal axis of its own


@dataclass(frozen=True)
class ContactPose:
    """The tool at rest on a surface, (45), its z axis into it.

    Attributes:
        p_WE: the contact point, m, shape (3,).
        q_WE: wxyz, shape (4,).
        n_W: unit normal of the surface, towards the robot, shape (3,).
    """

    p_WE: Array
    q_WE: Array
    n_W: Array

    def base(self, p_BE: Array, R_BE: Array) -> tuple[Array, Array]:
        """Pose of the base that puts the tool there, (40) and the last factor of (44).

        Args:
            p_BE, R_BE: pose of the tool in the base, m, shapes (3,) and (3, 3).

        Returns:
            p_WB, m, and q_WB, wxyz.
        """
        R_WB = Rotation.from_quat(self.q_WE, scalar_first=True) * Rotation.from_matrix(R_BE).inv()
        return self.p_WE - R_WB.apply(p_BE), R_WB.as_quat(scalar_first=True)

    def force_W(self, f_ref: float) -> Array:
        """Force of the robot on the surface in W for a pressing force, (46), N, shape (3,)."""
        return -self.n_W * f_ref

    def retreated(self, distance: float) -> Array:
        """Position of the tool at a distance in front of the surface, m, shape (3,)."""
        return self.p_WE + distance * self.n_W


def contact_attitude(n_W: Array, across_W: Array | None = None) -> Array:
    """Attitude R_WE of a tool that presses against a surface, (41)-(44): [alpha x beta, alpha, beta].

    beta, the tool's z axis, is into the surface; alpha, its y axis, is horizontal; so its x axis points down the wall.
    For a floor or a ceiling (41) is undefined: alpha then is `across_W`, made perpendicular to the normal.

    Args:
        n_W: normal of the surface, towards the robot, of any length, shape (3,).
        across_W: y axis of the tool on floors and ceilings; None is W's y axis.

    Returns:
        Rotation matrix, shape (3, 3).

    Raises:
        InputError: a normal that is zero or not finite, or `across_W` along the normal where it is needed.
    """
    length = np.linalg.norm(n_W)
    if not np.isfinite(length) or length == 0.0:
        raise InputError(f"normal of a surface is {np.asarray(n_W).tolist()}; valid: three finite numbers, not all 0")
    beta = -np.asarray(n_W) / length  # (42)
    alpha = np.cross(beta, -_UP)  # (41): gravity's direction
    if np.linalg.norm(alpha) < _LEVEL:
        across = np.array([0.0, 1.0, 0.0]) if across_W is None else np.asarray(across_W, dtype=float)
        alpha = across - (across @ beta) * beta
        if np.linalg.norm(alpha) < _LEVEL:
            raise InputError(f"across_W is {across.tolist()}; valid: a vector that is not along the normal")
    alpha = alpha / np.linalg.norm(alpha)  # (43)
    return np.column_stack([np.cross(alpha, beta), alpha, beta])  # (44)


def contact_pose(p_W: Array, n_W: Array, across_W: Array | None = None) -> ContactPose:
    """The tool on a point of a surface.

    Args:
        p_W: the point, m, shape (3,).
        n_W, across_W: as in `contact_attitude`.

    Raises:
        InputError: as `contact_attitude`.
    """
    R_WE = contact_attitude(n_W, across_W)
    q_WE = Rotation.from_matrix(R_WE).as_quat(scalar_first=True)
    return ContactPose(np.asarray(p_W, dtype=float), q_WE, -R_WE[:, 2])
