"""DenseProgramme: a quadratic programme as most solvers take it, and what a solution of it is worth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aerotact.exceptions import InputError
from aerotact.ports import Array
from aerotact.qp.solver import QpStatus


@dataclass(frozen=True)
class DenseSolution:
    """Solution of a DenseProgramme.

    Attributes:
        status: of the solver.
        x: (n,).
        z, y, z_box: multipliers of Gx <= h (>= 0), of Ax = b, of the bounds (> 0 at the upper side, < 0 at the lower).
        primal: largest violation of a constraint.
        dual: largest entry of Px + q + G'z + A'y + z_box, or multiplier of a side that is infinite.
        gap: |x'Px + q'x + h'z + b'y + bounds' z_box|, the duality gap.
        iterations: of the solver.
    """

    status: QpStatus
    x: Array
    z: Array
    y: Array
    z_box: Array
    primal: float
    dual: float
    gap: float
    iterations: int

    def within(self, tolerance: float) -> bool:
        """Whether violation, stationarity and gap are below an absolute tolerance, whatever the status."""
        return all(value <= tolerance for value in (self.primal, self.dual, self.gap))  # NaN is not


@dataclass(frozen=True)
class DenseProgramme:
    """min x'Px/2 + q'x, Gx <= h, Ax = b, lb <= x <= ub.

    Attributes:
        P, q: (n, n), symmetric, and (n,).
        G, h: (m, n) and (m,); h may be infinite.
        A, b: (p, n) and (p,).
        lb, ub: (n,); may be infinite.
    """

    P: Array
    q: Array
    G: Array
    h: Array
    A: Array
    b: Array
    lb: Array
    ub: Array

    @staticmethod
    def of(
        P: ArrayLike,
        q: ArrayLike,
        G: ArrayLike | None = None,
        h: ArrayLike | None = None,
        A: ArrayLike | None = None,
        b: ArrayLike | None = None,
        lb: ArrayLike | None = None,
        ub: ArrayLike | None = None,
    ) -> "DenseProgramme":
        """From what there is.

        Raises:
            InputError: sizes that do not fit.
        """
        linear = _vector(q)
        n = linear.size
        programme = DenseProgramme(
            P=np.atleast_2d(np.asarray(P, dtype=float)),
            q=linear,
            G=np.zeros((0, n)) if G is None else np.atleast_2d(np.asarray(G, dtype=float)),
            h=np.zeros(0) if h is None else _vector(h),
            A=np.zeros((0, n)) if A is None else np.atleast_2d(np.asarray(A, dtype=float)),
            b=np.zeros(0) if b is None else _vector(b),
            lb=np.full(n, -np.inf) if lb is None else _vector(lb),
            ub=np.full(n, np.inf) if ub is None else _vector(ub),
        )
        m, p = programme.h.size, programme.b.size
        valid = {"P": (n, n), "G": (m, n), "A": (p, n), "lb": (n,), "ub": (n,)}
        for name, shape in valid.items():
            if (given := getattr(programme, name).shape) != shape:
                raise InputError(f"{name} has shape {given}; valid for q, h, b of sizes {n}, {m}, {p}: {shape}")
        return programme

    def judge(self, status: QpStatus, x: Array, z: Array, y: Array, z_box: Array, iterations: int = 0) -> DenseSolution:
        """A solution with its residuals, recomputed from the data."""
        at_upper, at_lower = np.maximum(z_box, 0.0), np.minimum(z_box, 0.0)
        absent = np.concatenate(
            [z[~np.isfinite(self.h)], at_upper[~np.isfinite(self.ub)], at_lower[~np.isfinite(self.lb)]]
        )
        slope = self.P @ x + self.q
        balance = slope + self.G.T @ z + self.A.T @ y + z_box
        outside = np.concatenate([self.G @ x - self.h, np.abs(self.A @ x - self.b), self.lb - x, x - self.ub, [0.0]])
        sides = (self.h, z), (self.b, y), (self.ub, at_upper), (self.lb, at_lower)
        supports = sum(float(np.dot(np.where(np.isfinite(side), side, 0.0), value)) for side, value in sides)
        return DenseSolution(
            status=status,
            x=x,
            z=z,
            y=y,
            z_box=z_box,
            primal=float(outside.max()),
            dual=float(np.abs(np.concatenate([balance, absent])).max()),
            gap=abs(float(x @ slope) + supports),
            iterations=iterations,
        )


def _vector(value: ArrayLike) -> Array:
    return np.asarray(value, dtype=float).ravel()
