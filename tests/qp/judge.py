"""Judges answers by matrices of the whole problem, without a line of the solver's."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from problems import Problem
from scipy.optimize import linprog
from shapes import Shape
from solver import Answer

from aerotact.ports import Array

TOLERANCE = 1e-6
"""Largest relative KKT error of a right answer."""


@dataclass(frozen=True)
class Whole:
    """min 1/2 z'Pz + c'z, Ez = e, lower <= Gz <= upper, with z = (x_0..x_N, u_0..u_(N-1)).

    Rows: all controls, then all bounded states, then all general rows, each stage by stage. Soft rows may be left by
    s >= 0 at the cost linear s + 1/2 quadratic s^2.
    """

    P: sp.csc_array
    c: Array
    E: sp.csc_array
    e: Array
    G: sp.csr_array
    lower: Array
    upper: Array
    soft: Array
    linear: Array
    quadratic: Array

    @property
    def hard_upper(self) -> Array:
        return ~self.soft & np.isfinite(self.upper)

    @property
    def hard_lower(self) -> Array:
        return ~self.soft & np.isfinite(self.lower)


@dataclass(frozen=True)
class Errors:
    """Relative KKT errors."""

    stationarity: float
    feasibility: float
    complementarity: float

    @property
    def worst(self) -> float:
        return max(self.stationarity, self.feasibility, self.complementarity)


def whole(shape: Shape, problem: Problem) -> Whole:
    nx, nu, n = shape.pattern.nx, shape.pattern.nu, shape.pattern.steps
    size_x, size_u = (n + 1) * nx, n * nu
    S = sp.hstack([sp.block_diag(problem["S"]), sp.csr_array((size_u, nx))])
    P = sp.block_array([[sp.block_diag(problem["Q"]), S.T], [S, sp.block_diag(problem["R"])]])
    A = sp.vstack([sp.csr_array((nx, size_x)), sp.hstack([sp.block_diag(problem["A"]), sp.csr_array((n * nx, nx))])])
    B = sp.vstack([sp.csr_array((nx, size_u)), sp.block_diag(problem["B"])])
    rows = [(sp.hstack([sp.csr_array((size_u, size_x)), sp.eye_array(size_u)]), problem["lbu"], problem["ubu"])]
    penalties = [(np.zeros((n, nu), bool), np.zeros((n, nu)), np.zeros((n, nu)))]
    if shape.pattern.bounded:
        chosen = sp.eye_array(nx, format="csr")[list(shape.pattern.bounded)]
        lower, upper = problem["lbx"].copy(), problem["ubx"].copy()
        lower[0], upper[0] = -np.inf, np.inf
        G = sp.hstack([sp.kron(sp.eye_array(n + 1), chosen), sp.csr_array((lower.size, size_u))])
        rows.append((G, lower, upper))
        penalties.append(_penalties(problem, "x", shape.pattern.soft_bounds, n))
    if shape.pattern.general:
        D = sp.vstack([sp.block_diag(problem["D"]), sp.csr_array((shape.pattern.general, size_u))])
        rows.append((sp.hstack([sp.block_diag(problem["C"]), D]), problem["lg"], problem["ug"]))
        penalties.append(_penalties(problem, "g", shape.pattern.soft_rows, n))
    return Whole(
        P.tocsc(),
        np.concatenate([problem["q"].ravel(), problem["r"].ravel()]),
        sp.hstack([sp.eye_array(size_x) - A, -B]).tocsc(),
        np.concatenate([problem["x0"], problem["b"].ravel()]),
        sp.vstack([row[0] for row in rows]).tocsr(),
        *(np.concatenate([row[i].ravel() for row in rows]) for i in (1, 2)),
        *(np.concatenate([penalty[i].ravel() for penalty in penalties]) for i in (0, 1, 2)),
    )


def _penalties(problem: Problem, name: str, soft: tuple[bool, ...], steps: int) -> tuple[Array, Array, Array]:
    size = (steps + 1, len(soft))
    zeros = np.zeros(size)
    linear, quadratic = problem.get(f"soft_{name}_lin", zeros), problem.get(f"soft_{name}_quad", zeros)
    return np.broadcast_to(np.array(soft), size), linear, quadratic


def kkt_errors(shape: Shape, problem: Problem, answer: Answer) -> Errors:
    """How far an answer is from the KKT conditions, relative to the sizes of the gradients and of the point."""
    w = whole(shape, problem)
    z, pi = np.concatenate([answer.x.ravel(), answer.u.ravel()]), answer.pi.ravel()
    nu, nb, n = shape.pattern.nu, len(shape.pattern.bounded), shape.pattern.steps
    parts = [answer.y[:n, :nu], answer.y[:, nu : nu + nb], answer.y[:, nu + nb :]]
    y = np.concatenate([part.ravel() for part in parts])
    cost, rows = w.P @ z + w.c, w.G.T @ y
    gradient = cost + rows - w.E.T @ np.concatenate([np.zeros(shape.pattern.nx), pi])
    gradient[: shape.pattern.nx] = 0.0  # x_0 is given
    scale = max(np.abs(cost).max(), np.abs(rows).max(), np.abs(pi).max(), 1e-300)
    size = np.abs(z).max()
    value = w.G @ z
    slack = np.maximum(np.maximum(value - w.upper, w.lower - value), 0.0)
    missed = max(np.abs(w.E @ z - w.e).max(), slack[~w.soft].max(initial=0.0))
    distance = np.maximum(np.where(y > 0.0, w.upper - value, np.where(y < 0.0, value - w.lower, 0.0)), 0.0)
    spare = np.where(w.soft, w.linear + w.quadratic * slack - np.abs(y), 0.0)  # multiplier of the slack
    products = max((np.abs(y) * distance).max(), (np.abs(spare) * slack).max())
    return Errors(
        max(np.abs(gradient).max(), np.maximum(-spare, 0.0).max()) / scale,
        missed / (1.0 + size),
        products / (scale * max(1.0, min(size, 1e3))),
    )


def feasible(shape: Shape, problem: Problem) -> bool | None:
    """Whether the hard rows leave anything, by HiGHS; None if it does not know."""
    w = whole(shape, problem)
    G = sp.vstack([w.G[w.hard_upper], -w.G[w.hard_lower]])
    h = np.concatenate([w.upper[w.hard_upper], -w.lower[w.hard_lower]])
    zero = np.zeros(w.G.shape[1])
    result = linprog(zero, A_ub=G, b_ub=h, A_eq=w.E, b_eq=w.e, bounds=(None, None), method="highs")
    return {0: True, 2: False}.get(result.status)
