"""SO(3) in CasADi: unit quaternions wxyz, rotation matrices, and a three-coordinate chart.

The chart is four times the modified Rodrigues parameters, sigma = 4 q_v / (1 + q_w): equal to the rotation vector up to
third order, rational (no trigonometry), smooth for every angle below 2 pi; with the sign of q chosen so that q_w >= 0
its norm is at most 4, reached at pi.
"""

from typing import Any

import casadi as ca


def skew(a: Any) -> Any:
    """Matrix [a]x with [a]x b = a x b."""
    return ca.vertcat(
        ca.horzcat(0, -a[2], a[1]),
        ca.horzcat(a[2], 0, -a[0]),
        ca.horzcat(-a[1], a[0], 0),
    )


def vee(S: Any) -> Any:
    """Inverse of `skew`."""
    return ca.vertcat(S[2, 1], S[0, 2], S[1, 0])


def rotation(q: Any) -> Any:
    """Rotation matrix R_AB of the unit quaternion q_AB."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def product(a: Any, b: Any) -> Any:
    """Quaternion product a * b, so that rotation(a * b) = rotation(a) rotation(b)."""
    return ca.vertcat(
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def conjugate(q: Any) -> Any:
    """Inverse of a unit quaternion."""
    return ca.vertcat(q[0], -q[1], -q[2], -q[3])


def unit(q: Any) -> Any:
    """q scaled to length one."""
    return q / ca.sqrt(ca.sumsqr(q))


def quaternion_rate(q: Any, w_B: Any) -> Any:
    """dq_WB/dt for the body rate w_B, rad/s in B."""
    return 0.5 * product(q, ca.vertcat(0, w_B))


def from_chart(sigma: Any) -> Any:
    """Unit quaternion of chart coordinates (3,)."""
    s2 = ca.sumsqr(sigma)
    return ca.vertcat(16 - s2, 8 * sigma) / (16 + s2)


def to_chart(q: Any) -> Any:
    """Chart coordinates (3,) of a unit quaternion, the short way round."""
    sign = ca.if_else(q[0] < 0, -1, 1)
    return 4 * sign * q[1:4] / (1 + sign * q[0])


def retract(q: Any, sigma: Any) -> Any:
    """q (+) sigma: turned by sigma in the body's own axes."""
    return product(q, from_chart(sigma))


def local(q_from: Any, q_to: Any) -> Any:
    """sigma with q_from (+) sigma = +-q_to."""
    return to_chart(product(conjugate(q_from), q_to))


def exponential(phi: Any) -> Any:
    """Unit quaternion of the rotation vector phi (3,), rad; exact, smooth at zero."""
    half2 = ca.sumsqr(phi) / 4
    small = half2 < 1e-8
    half = ca.sqrt(ca.if_else(small, 1e-8, half2))
    sinc = ca.if_else(small, 1 - half2 / 6, ca.sin(half) / half)
    cos = ca.if_else(small, 1 - half2 / 2, ca.cos(half))
    return ca.vertcat(cos, 0.5 * sinc * phi)
