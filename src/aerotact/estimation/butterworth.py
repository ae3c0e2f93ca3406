"""Butterworth: a discrete second-order low-pass whose cut-off can be changed at run time."""

from typing import Any

import casadi as ca
import numpy as np


def butterworth(cutoff: Any, rate: float) -> tuple[Any, Any]:
    """Coefficients of the second-order low-pass by the bilinear transform, exact at the cut-off.

    Args:
        cutoff: Hz, below rate / 2.
        rate: Hz.

    Returns:
        b (3,) and a (3,) of b0 + b1/z + b2/z^2 over a0 + a1/z + a2/z^2 with a0 = 1.
    """
    k = ca.tan(np.pi * cutoff / rate)
    scale = 1 / (1 + np.sqrt(2) * k + k * k)
    b0 = k * k * scale
    return ca.vertcat(b0, 2 * b0, b0), ca.vertcat(1, 2 * (k * k - 1) * scale, (1 - np.sqrt(2) * k + k * k) * scale)


def low_pass(b: Any, a: Any, z1: Any, z2: Any, u: Any) -> tuple[Any, Any, Any]:
    """One step of the filter (transposed direct form II), component by component: output, next z1, next z2."""
    y = b[0] * u + z1
    return y, b[1] * u - a[1] * y + z2, b[2] * u - a[2] * y


def at_rest(b: Any, a: Any, u: Any) -> tuple[Any, Any]:
    """z1 and z2 of a filter that has seen the constant input u for ever."""
    return (1 - b[0]) * u, (b[2] - a[2]) * u
