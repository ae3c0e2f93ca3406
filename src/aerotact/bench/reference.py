"""Reference: the accurate solution of a Qp, to measure the errors of others.

An active set is guessed (the last one, else that of an interior point method), solved for by one sparse factorisation
with iterative refinement, and changed until every bound holds and every multiplier has the right sign. Such a solution
is exact to round-off. Where multipliers are not unique and the signs never agree, the interior point's own answer
stands; `exact` tells.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from aerotact.bench.qp import Qp, Solution
from aerotact.ports import Array

_TOLERANCE = 1e-10
_ROUNDS = 12
_ITERATIONS = 80
_REGULAR = 1e-13


@dataclass(frozen=True)
class Reference:
    """The solution and its active set: -1 at the lower side, 1 at the upper, 0 free, a row of G each."""

    solution: Solution
    active: Array
    exact: bool


def solve_exactly(qp: Qp, guess: Array | None = None) -> Reference:
    """Accurate solution; `guess` is the active set to begin with.

    Raises:
        ValueError: the interior point method does not converge: the Qp has no solution.
    """
    if guess is not None and (found := _active_set(qp, guess)) is not None:
        return found
    z, y = _interior_point(qp)
    *_, G, lower, upper = qp.sparse
    v = G @ z
    near = np.minimum(v - lower, upper - v) < 1e-3 * np.abs(y)
    found = _active_set(qp, np.where(near, np.sign(y), 0.0))
    if found is not None:
        return found
    x, u = qp.split(z)
    return Reference(Solution(x, u, y), np.where(near, np.sign(y), 0.0), exact=False)


def _refined(K: Any, rhs: Array, n: int) -> Array:
    """Solve the symmetric indefinite system; regularised, then refined."""
    diagonal = np.concatenate([np.full(n, _REGULAR), np.full(K.shape[0] - n, -_REGULAR)])
    factor = sla.splu((K + sp.diags(diagonal)).tocsc())
    s = factor.solve(rhs)
    for _ in range(4):
        s = s + factor.solve(rhs - K @ s)
    return s


def _active_set(qp: Qp, guess: Array) -> Reference | None:
    """Primal-dual active set from a guess; None if it does not settle."""
    P, c, E, e, G, lower, upper = qp.sparse
    active = guess.astype(float).copy()
    n, rows = len(c), E.shape[0]
    for _ in range(_ROUNDS):
        held = np.flatnonzero(active)
        C = sp.vstack([E, G[held]]).tocsc()
        bound = np.where(active[held] > 0, upper[held], lower[held])
        K = sp.bmat([[P, C.T], [C, None]]).tocsc()
        s = _refined(K, np.concatenate([-c, e, bound]), n)
        if not np.isfinite(s).all():
            return None
        z, y = s[:n], np.zeros(len(lower))
        y[held] = s[n + rows :]
        v = G @ z
        scale = _TOLERANCE * (1 + np.abs(v))
        wrong = held[y[held] * active[held] < -_TOLERANCE * (1 + np.abs(y[held]).max(initial=0.0))]
        over, under = (v > upper + scale) & (active == 0), (v < lower - scale) & (active == 0)
        if np.abs(v[held] - bound).max(initial=0.0) > 1e-8:  # bounds that contradict the dynamics
            return None
        if not wrong.size and not over.any() and not under.any():
            x, u = qp.split(z)
            return Reference(Solution(x, u, y), active, exact=True)
        active[wrong] = 0.0
        active[over], active[under] = 1.0, -1.0
    return None


def _interior_point(qp: Qp) -> tuple[Array, Array]:
    """Mehrotra's predictor and corrector on the sparse system; (z, y)."""
    P, c, E, e, G, lower, upper = qp.sparse
    low, high = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    C = sp.vstack([G[high], -G[low]]).tocsc()
    d = np.concatenate([upper[high], -lower[low]])
    n, rows = len(c), E.shape[0]
    z, pi = np.zeros(n), np.zeros(rows)
    t, lam = np.maximum(d - C @ z, 1.0), np.ones(len(d))
    size = 1 + np.abs(c).max()
    for _ in range(_ITERATIONS):
        dual = P @ z + c + E.T @ pi + C.T @ lam
        primal, gap = E @ z - e, C @ z + t - d
        mu = t @ lam / max(len(d), 1)
        worst = max(np.abs(dual).max() / size, np.abs(primal).max(), np.abs(gap).max(initial=0.0))
        if worst < _TOLERANCE and mu < 1e-12 * size:
            break
        K = sp.bmat([[P + C.T @ sp.diags(lam / t) @ C, E.T], [E, None]]).tocsc()
        diagonal = np.concatenate([np.full(n, 1e-12), np.full(rows, -1e-12)])
        factor = sla.splu(K + sp.diags(diagonal).tocsc())

        def direction(
            target: Array,
            dual: Array = dual,
            primal: Array = primal,
            gap: Array = gap,
            K: Any = K,
            factor: Any = factor,
            t: Array = t,
            lam: Array = lam,
        ) -> tuple[Array, Array, Array, Array]:
            rhs = np.concatenate([-dual - C.T @ ((lam * gap - target) / t), -primal])
            s = factor.solve(rhs)
            for _ in range(2):
                s = s + factor.solve(rhs - K @ s)
            dt = -gap - C @ s[:n]
            return s[:n], s[n:], dt, (-target - lam * dt) / t

        *_, dt, dlam = direction(t * lam)
        alpha = min(_longest(t, dt), _longest(lam, dlam))
        sigma = ((t + alpha * dt) @ (lam + alpha * dlam) / max(t @ lam, 1e-300)) ** 3
        dz, dpi, dt, dlam = direction(t * lam + dt * dlam - sigma * mu)
        alpha = 0.995 * min(_longest(t, dt), _longest(lam, dlam))
        z, pi, t, lam = z + alpha * dz, pi + alpha * dpi, t + alpha * dt, lam + alpha * dlam
    else:
        if worst > 1e-6:
            raise ValueError(f"no solution: residual {worst:.2e} after {_ITERATIONS} iterations")
    y = np.zeros(len(lower))
    y[high] += lam[: len(high)]
    y[low] -= lam[len(high) :]
    return z, y


def _longest(value: Array, change: Array) -> float:
    """Longest step up to 1 that keeps every value positive."""
    shrinking = change < 0
    return float(min(1.0, (-value[shrinking] / change[shrinking]).min(initial=1.0)))
