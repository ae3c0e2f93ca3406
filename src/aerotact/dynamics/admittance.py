"""Admittance: a virtual mass-spring-damper between the desired and the reference pose of the tool.

ryll2019 (27)-(28), with the errata's signs: M a + D v + K e = w, where e and v are reference minus desired and w is the
wrench of the environment on the tool. Rotational quantities are in W, as in the paper. Each matrix is diagonal.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.ports import BlockBuilder


@dataclass(frozen=True)
class ToolMotion:
    """Pose and motion of the tool: p_WE m, q_WE, v_WE m/s, w_WE rad/s, a_WE m/s2, dw_WE rad/s2; vectors in W."""

    p_WE: Any
    q_WE: Any
    v_WE: Any
    w_WE: Any
    a_WE: Any
    dw_WE: Any


@dataclass(frozen=True)
class Admittance:
    """Diagonals of the virtual inertia M (kg; kg m2), damping D (N s/m; N m s/rad) and stiffness K (N/m; N m/rad)."""

    M_p: Any
    D_p: Any
    K_p: Any
    M_r: Any
    D_r: Any
    K_r: Any


LEAST_INERTIA = 1e-6  # kg and kg m2; (27) divides by it


def add_parameters(b: BlockBuilder) -> tuple[Admittance, Any, Any]:
    """Parameters of (27), with the paper's nominal values, and the dead zones of force, N, and torque, N m."""

    def parameter(name: str, unit: str, default: Any, doc: str, lower: float = 0.0) -> Any:
        return b.parameter(name, 3, unit, default, frame="W", doc=f"virtual {doc}, (27)", lower=lower)

    law = Admittance(
        M_p=parameter("M_EP", "kg", 1.5, "mass", LEAST_INERTIA),
        D_p=parameter("D_EP", "N s/m", 10.0, "damping"),
        K_p=parameter("K_EP", "N/m", 6.0, "stiffness"),
        M_r=parameter("M_ER", "kg m^2", (0.01, 0.01, 0.02), "inertia", LEAST_INERTIA),
        D_r=parameter("D_ER", "N m s/rad", 4.0, "rotational damping"),
        K_r=parameter("K_ER", "N m/rad", (10.0, 10.0, 5.0), "rotational stiffness"),
    )
    force = b.parameter("dead_zone_force", 1, "N", 0.2, doc="force below which the tool feels nothing", lower=0.0)
    torque = b.parameter("dead_zone_torque", 1, "N m", 0.2, doc="torque below which the tool feels nothing", lower=0.0)
    return law, force, torque


def attitude_error(q_from: Any, q_to: Any) -> Any:
    """1/2 (R_to R_from' - R_from R_to')^vee, in W: ryll2019 (28), the turn from `from` to `to`."""
    R = ca.mtimes(so3.rotation(q_to), so3.rotation(q_from).T)
    return 0.5 * so3.vee(R - R.T)


def dead_zone(vector: Any, threshold: Any) -> Any:
    """The vector shortened by the threshold, zero below it; continuous (ryll2019, Practical Implementation)."""
    norm = ca.sqrt(ca.sumsqr(vector) + 1e-24)
    return vector * ca.fmax(norm - threshold, 0) / norm


def acceleration(law: Admittance, desired: ToolMotion, reference: ToolMotion, wrench_W: Any) -> tuple[Any, Any]:
    """Acceleration of the reference, (27) solved for it: linear m/s2 and angular rad/s2, in W."""
    e_p = reference.p_WE - desired.p_WE
    e_r = attitude_error(desired.q_WE, reference.q_WE)
    de_p, de_r = reference.v_WE - desired.v_WE, reference.w_WE - desired.w_WE
    linear = desired.a_WE + (wrench_W[0:3] - law.D_p * de_p - law.K_p * e_p) / law.M_p
    angular = desired.dw_WE + (wrench_W[3:6] - law.D_r * de_r - law.K_r * e_r) / law.M_r
    return linear, angular


def advance(
    law: Admittance, desired: ToolMotion, ahead: ToolMotion, reference: ToolMotion, wrench_W: Any, h: float
) -> ToolMotion:
    """The reference h seconds later, with the wrench held.

    Exact for the translation at any h; the rotation takes (28) as linear over the step.

    Args:
        law: the virtual impedance.
        desired: the desired motion now.
        ahead: the desired motion h seconds later.
        reference: the reference now.
        wrench_W: wrench on the tool, (6,), N and N m, in W.
        h: step, s.

    Returns:
        The reference h seconds later, with the acceleration it has then.
    """
    e_p, de_p = reference.p_WE - desired.p_WE, reference.v_WE - desired.v_WE
    e_r, de_r = attitude_error(desired.q_WE, reference.q_WE), reference.w_WE - desired.w_WE
    e_p_next, de_p_next = _respond(law.M_p, law.D_p, law.K_p, e_p, de_p, wrench_W[0:3], h)
    e_r_next, de_r_next = _respond(law.M_r, law.D_r, law.K_r, e_r, de_r, wrench_W[3:6], h)
    # d/dt (R_r R_d') = [w_r - R_r R_d' w_d]x R_r R_d'
    turn = so3.product(reference.q_WE, so3.conjugate(desired.q_WE))
    carried = h / 2 * (desired.w_WE + ahead.w_WE)
    slip = e_r_next - e_r + carried - ca.mtimes(so3.rotation(turn), carried)
    q_WE = so3.unit(so3.product(so3.product(so3.exponential(slip), turn), ahead.q_WE))
    moved = ToolMotion(ahead.p_WE + e_p_next, q_WE, ahead.v_WE + de_p_next, ahead.w_WE + de_r_next, None, None)
    a_WE, dw_WE = acceleration(law, ahead, moved, wrench_W)
    return ToolMotion(moved.p_WE, moved.q_WE, moved.v_WE, moved.w_WE, a_WE, dw_WE)


def _respond(M: Any, D: Any, K: Any, e: Any, de: Any, w: Any, h: float) -> tuple[Any, Any]:
    """Displacement and velocity h later of M e'' + D e' + K e = w: the exact solution, axis by axis.

    With decay s = D/2M and stiffness k = K/M the impulse response is S = (exp(r1 h) - exp(r2 h)) / (r1 - r2) where
    r = -s +- sqrt(s^2 - k), or exp(-s h) sin(f h)/f where f = sqrt(k - s^2). Near the double root and without a spring
    the formulas are evaluated a little beside, where they are still well conditioned.
    """
    s, k = D / (2 * M), ca.fmax(K / M, 1e-9 / h**2)
    discriminant = s * s - k
    root = ca.sqrt(ca.fmax(ca.fabs(discriminant), 1e-10 * (s * s + k)))
    fast, slow = ca.exp((-s - root) * h), ca.exp((-s + root) * h)
    decay = ca.exp(-s * h)
    damped = discriminant > 0
    S = ca.if_else(damped, (slow - fast) / (2 * root), decay * ca.sin(root * h) / root)
    C = ca.if_else(damped, (slow + fast) / 2, decay * ca.cos(root * h))
    stay = C + s * S
    return stay * e + S * de + (1 - stay) / (k * M) * w, (C - s * S) * de + S * (w / M - k * e)
