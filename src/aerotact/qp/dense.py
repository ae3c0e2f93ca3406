"""Quadratic programmes that are no optimal control problems, put to the OCP QP solver: one stage, controls only."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike

from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern
from aerotact.exceptions import InputError
from aerotact.ports import Array
from aerotact.qp.solver import QpResult, QpSolver, QpStatus


@dataclass(frozen=True)
class OcpQp:
    """An OCP QP that stands for a dense programme.

    Attributes:
        pattern: its size and sparsity.
        data: by the names of the generated header.
        inequalities: the first of its general rows that are Gx <= h; the others are Ax = b.
    """

    pattern: QpPattern
    data: dict[str, Array]
    inequalities: int


@dataclass(frozen=True)
class DenseSolution:
    """Solution of min 1/2 x'Px + q'x, Gx <= h, Ax = b, lb <= x <= ub.

    Attributes:
        status: of the solver.
        x: (n,).
        z, y, z_box: multipliers of Gx <= h (>= 0), of Ax = b, of the bounds (> 0 at the upper side, < 0 at the lower).
        primal, dual: largest violation of a constraint and of stationarity Px + q + G'z + A'y + z_box = 0.
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
        return max(self.primal, self.dual, self.gap) <= tolerance  # NaN is not


def dense_qp(
    P: ArrayLike,
    q: ArrayLike,
    G: ArrayLike | None = None,
    h: ArrayLike | None = None,
    A: ArrayLike | None = None,
    b: ArrayLike | None = None,
    lb: ArrayLike | None = None,
    ub: ArrayLike | None = None,
) -> OcpQp:
    """An OCP QP with the same solution: N = 1, u_0 = x; rows of G and of A are general rows, those of A with lg = ug.

    The state, which the interface needs, is one number that stays 1.

    Args:
        P, q: (n, n), symmetric, and (n,).
        G, h: (m, n) and (m,), G x <= h; h may be infinite.
        A, b: (p, n) and (p,), A x = b.
        lb, ub: (n,); may be infinite.

    Raises:
        InputError: sizes that do not fit.
    """
    cost, linear = _matrix(P), np.asarray(q, dtype=float).ravel()
    n = linear.size
    rows_G, upper = _rows("G", G, h, n)
    rows_A, equal = _rows("A", A, b, n)
    lower_x = np.full(n, -np.inf) if lb is None else np.asarray(lb, dtype=float).ravel()
    upper_x = np.full(n, np.inf) if ub is None else np.asarray(ub, dtype=float).ravel()
    if cost.shape != (n, n) or lower_x.size != n or upper_x.size != n:
        raise InputError(
            f"P {cost.shape}, lb {lower_x.size}, ub {upper_x.size}; valid for {n} variables: ({n}, {n}), {n}, {n}"
        )
    rows = np.vstack([rows_G, rows_A])
    count = len(rows)
    data = {
        "x0": np.ones(1),
        "A": np.ones((1, 1)),
        "Q": np.ones((2, 1)),
        "R": cost.ravel(),
        "r": linear,
        "lbu": lower_x,
        "ubu": upper_x,
    }
    if count:
        free = np.full(count, np.inf)
        data["D"] = rows.ravel()
        data["lg"] = np.stack([np.concatenate([np.full(len(upper), -np.inf), equal]), -free])
        data["ug"] = np.stack([np.concatenate([upper, equal]), free])
    pattern = QpPattern(
        nx=1,
        nu=n,
        steps=1,
        general=count,
        A=[[ONE]],
        B=[[ZERO] * n],
        R=np.where(cost != 0.0, FREE, ZERO).tolist(),
        S=[[ZERO]] * n,
    )
    return OcpQp(pattern, data, len(upper))


def solve_dense(
    P: ArrayLike,
    q: ArrayLike,
    G: ArrayLike | None = None,
    h: ArrayLike | None = None,
    A: ArrayLike | None = None,
    b: ArrayLike | None = None,
    lb: ArrayLike | None = None,
    ub: ArrayLike | None = None,
    solver: QpSolver | None = None,
) -> DenseSolution:
    """Solve by the generated C of the back end aerotact; arguments as of dense_qp.

    Args:
        P, q, G, h, A, b, lb, ub: the programme.
        solver: for an earlier programme of the same sizes and the same sparsity of P, which then is the warm start;
            without it, one is compiled (or taken from the cache).

    Raises:
        InputError: sizes that do not fit.
        CompilerNotFound, CodegenError: as QpSolver.
    """
    programme = dense_qp(P, q, G, h, A, b, lb, ub)
    found = (solver or QpSolver(programme.pattern)).solve(programme.data)
    return dense_solution(programme, found)


def dense_solution(programme: OcpQp, found: QpResult) -> DenseSolution:
    """Multipliers by kind, and residuals from the programme's own data."""
    inequalities = programme.inequalities
    data, n = programme.data, programme.pattern.nu
    x, rows = found.u[0], programme.pattern.general
    P, D = data["R"].reshape(n, n), data.get("D", np.zeros(0)).reshape(rows, n)
    lower = np.concatenate([data["lbu"], data["lg"][0] if rows else []])
    upper = np.concatenate([data["ubu"], data["ug"][0] if rows else []])
    multipliers, values = found.y[0], np.concatenate([x, D @ x])
    at_upper, at_lower = np.maximum(multipliers, 0.0), np.minimum(multipliers, 0.0)
    # A multiplier of a side that is not there is an error of stationarity, not of the gap.
    bound_terms = np.dot(at_upper, np.where(np.isfinite(upper), upper, 0.0))
    bound_terms += np.dot(at_lower, np.where(np.isfinite(lower), lower, 0.0))
    absent = np.concatenate([at_upper[~np.isfinite(upper)], at_lower[~np.isfinite(lower)], [0.0]])
    slope = P @ x + data["r"]
    balance = slope + multipliers[:n] + D.T @ multipliers[n:]
    violation = np.concatenate([values - upper, lower - values, [0.0]])
    return DenseSolution(
        status=found.status,
        x=x,
        z=multipliers[n : n + inequalities],
        y=multipliers[n + inequalities :],
        z_box=multipliers[:n],
        primal=float(violation.max()),
        dual=float(max(np.abs(balance).max(), np.abs(absent).max())),
        gap=float(abs(x @ slope + bound_terms)),
        iterations=found.iterations,
    )


def _matrix(value: ArrayLike) -> Array:
    dense = value.toarray() if scipy.sparse.issparse(value) else value  # type: ignore[union-attr]
    return np.atleast_2d(np.asarray(dense, dtype=float))


def _rows(name: str, matrix: ArrayLike | None, side: ArrayLike | None, n: int) -> tuple[Array, Array]:
    """Rows (m, n) and their right-hand sides (m,); none of either if there is no matrix."""
    if matrix is None or side is None:
        return np.zeros((0, n)), np.zeros(0)
    rows, values = _matrix(matrix), np.asarray(side, dtype=float).ravel()
    if rows.shape != (values.size, n):
        raise InputError(f"{name}: {rows.shape} with {values.size} sides; valid: ({values.size}, {n})")
    return rows, values
