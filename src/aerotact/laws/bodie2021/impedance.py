"""Variable axis-selective impedance: errors (3)-(4), virtual inertia (8)-(9), impedance wrench (10)-(12) and (23)."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.motion import BaseMotion
from aerotact.ports import BlockBuilder

LEAST_INERTIA = 0.02  # multiplier; (12) divides by it


@dataclass(frozen=True)
class Errors:
    """Errors of (3) in B: position m, attitude, velocity m/s, angular velocity rad/s, each (3,)."""

    e_p: Any
    e_R: Any
    e_v: Any
    e_w: Any


@dataclass(frozen=True)
class Impedance:
    """Effective stiffness and damping of (11), diagonals in B (3,), and multipliers of the real inertia of (9)."""

    K_lin: Any
    D_lin: Any
    K_ang: Any
    D_ang: Any
    m_wall: Any
    m_free: Any
    J_v: Any


def add_impedance(b: BlockBuilder) -> Impedance:
    """Parameters, with the values of Table IV for experiments B and C."""

    def gain(name: str, unit: str, default: float, doc: str) -> Any:
        return b.parameter(name, 3, unit, default, frame="B", doc=f"effective {doc}, (11)", lower=0.0)

    def multiplier(name: str, default: float, doc: str) -> Any:
        return b.parameter(name, 1, "1", default, doc=f"virtual {doc} over the real one, (9)", lower=LEAST_INERTIA)

    return Impedance(
        K_lin=gain("K_lin", "N/m", 100.0, "stiffness"),
        D_lin=gain("D_lin", "N s/m", 35.0, "damping"),
        K_ang=gain("K_ang", "N m/rad", 3.5, "rotational stiffness"),
        D_ang=gain("D_ang", "N m s/rad", 1.2, "rotational damping"),
        m_wall=multiplier("m_wall", 0.5, "mass along the tool's axis at the wall"),
        m_free=multiplier("m_free", 5.0, "mass otherwise"),
        J_v=multiplier("J_v", 5.0, "inertia"),
    )


def tracking_errors(base: BaseMotion, reference: BaseMotion) -> Errors:
    """Errors of pose and velocity, actual minus reference: (3)."""
    R_BW = so3.rotation(base.q_WB).T
    R_BBr = ca.mtimes(R_BW, so3.rotation(reference.q_WB))
    return Errors(
        e_p=ca.mtimes(R_BW, base.p_WB - reference.p_WB),
        e_R=0.5 * so3.vee(R_BBr.T - R_BBr),
        e_v=ca.mtimes(R_BW, base.v_WB - reference.v_WB),
        e_w=base.w_B - ca.mtimes(R_BBr, reference.w_B),
    )


def reference_acceleration(base: BaseMotion, reference: BaseMotion) -> tuple[Any, Any]:
    """v_dot_ref of (7), an erratum, m/s2 and rad/s2: the reference's velocities in B, differentiated in B's axes."""
    R_BW, w = so3.rotation(base.q_WB).T, base.w_B
    R_BBr = ca.mtimes(R_BW, so3.rotation(reference.q_WB))
    linear = ca.mtimes(R_BW, reference.a_WB) - ca.cross(w, ca.mtimes(R_BW, reference.v_WB))
    angular = ca.mtimes(R_BBr, reference.dw_B) - ca.cross(w, ca.mtimes(R_BBr, reference.w_B))
    return linear, angular


def mass_ratio(impedance: Impedance, axis_B: Any, near: Any) -> Any:
    """Linear part of the inverse of the normalised inertia, M M_v^-1 with (8)-(9) and the errata: (3, 3) in B.

    Along the tool's axis the virtual mass goes from m_free to m_wall as the surface comes near; across it stays m_free.
    Written as a sum of projections, it needs no rotation of the tool's frame and no inverse of a matrix.

    Args:
        impedance: multipliers of the real mass.
        axis_B: unit vector along the tool's axis, (3,).
        near: c of (8), in [0, 1].
    """
    m_T = near * impedance.m_wall + (1 - near) * impedance.m_free
    along = ca.mtimes(axis_B, axis_B.T)
    return along / m_T + (ca.DM.eye(3) - along) / impedance.m_free


def impedance_wrench(
    impedance: Impedance, errors: Errors, ratio: Any, selection: Any, p_BE: Any, f_ext: Any, tau_ext: Any
) -> tuple[Any, Any]:
    """Force, N, and torque, N m, about the base's origin of the impedance: (23) with the errata.

    The selected part of the estimated force, which direct force control answers for, is taken out, and so is the torque
    that it has about the base's origin when it acts on the tool's tip.

    Args:
        impedance: gains.
        errors: (3).
        ratio: `mass_ratio`.
        selection: Lambda of (18), (3, 3).
        p_BE: tool's tip in B, m.
        f_ext: estimated force of the environment on the robot, N in B.
        tau_ext: estimated torque about the base's origin, N m in B.
    """
    apparent = ca.mtimes(ratio, f_ext) - f_ext
    f = apparent - ca.mtimes(selection, apparent) - impedance.D_lin * errors.e_v - impedance.K_lin * errors.e_p
    tau_other = tau_ext - ca.cross(p_BE, ca.mtimes(selection, f_ext))
    tau = (1 / impedance.J_v - 1) * tau_other - impedance.D_ang * errors.e_w - impedance.K_ang * errors.e_R
    return f, tau
