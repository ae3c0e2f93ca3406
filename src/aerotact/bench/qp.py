"""Qp: the quadratic programme of one real-time iteration, as numbers, and how well an answer solves it.

    min  sum_(k<N) [x_k; u_k]' [Q_k S_k'; S_k R_k] [x_k; u_k] / 2 + q_k'x_k + r_k'u_k  +  x_N'Q_N x_N / 2 + q_N'x_N
    s.t. x_0 given,  x_(k+1) = A_k x_k + B_k u_k + b_k,  lbu_k <= u_k <= ubu_k,  lbx_k <= x_k[bounded] <= ubx_k (k >= 1)

in the changes of states (n) and controls (m).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from aerotact.mpc.transcription import Transcription
from aerotact.ports import Array


@dataclass(frozen=True)
class Qp:
    """The data.

    Attributes:
        A, B, b: (N, n, n), (N, n, m), (N, n).
        Q, S, R, q, r: (N + 1, n, n), (N, m, n), (N, m, m), (N + 1, n), (N, m).
        x0: (n,).
        lbu, ubu: (N, m). lbx, ubx: (N + 1, len(bounded)); the first row does not count.
        bounded: indices of the bounded coordinates.
    """

    A: Array
    B: Array
    b: Array
    Q: Array
    S: Array
    R: Array
    q: Array
    r: Array
    x0: Array
    lbu: Array
    ubu: Array
    lbx: Array
    ubx: Array
    bounded: Array

    @property
    def dimensions(self) -> tuple[int, int, int]:
        """Intervals N, coordinates n, controls m."""
        return len(self.A), self.A.shape[1], self.B.shape[2]

    @cached_property
    def sparse(self) -> tuple[Any, Array, Any, Array, Any, Array, Array]:
        """(P, c, E, e, G, lower, upper) of  min z'Pz/2 + c'z,  E z = e,  lower <= G z <= upper.

        z holds x_0 .. x_N, then u_0 .. u_(N-1). The rows of E are x_0 and the dynamics; those of G are the controls
        stage by stage, then the bounded coordinates of nodes 1 .. N; absent bounds are infinite.
        """
        N, n, m = self.dimensions
        corner = sp.block_diag([np.zeros((m, n)) if not self.S[k].any() else self.S[k] for k in range(N)])
        S = sp.hstack([corner, sp.csr_matrix((N * m, n))])
        P = sp.bmat([[sp.block_diag(list(self.Q)), S.T], [S, sp.block_diag(list(self.R))]]).tocsc()
        c = np.concatenate([self.q.ravel(), self.r.ravel()])
        dynamics = sp.bmat(
            [
                [
                    sp.csr_matrix((n, (N + 1) * n + N * m))
                    + sp.hstack([sp.eye(n), sp.csr_matrix((n, N * n + N * m))], format="csr")
                ],
                [
                    sp.hstack(
                        [
                            sp.hstack([sp.csr_matrix((N * n, n)), sp.eye(N * n)])
                            - sp.hstack([sp.block_diag(list(self.A)), sp.csr_matrix((N * n, n))]),
                            -sp.block_diag(list(self.B)),
                        ]
                    )
                ],
            ]
        ).tocsc()
        e = np.concatenate([self.x0, self.b.ravel()])
        where = (np.arange(1, N + 1)[:, None] * n + self.bounded[None, :]).ravel().astype(int)
        rows = np.concatenate([(N + 1) * n + np.arange(N * m), where])
        G = sp.csr_matrix((np.ones(rows.size), (np.arange(rows.size), rows)), shape=(rows.size, (N + 1) * n + N * m))
        lower = np.concatenate([self.lbu.ravel(), self.lbx[1:].ravel()])
        upper = np.concatenate([self.ubu.ravel(), self.ubx[1:].ravel()])
        return P, c, dynamics, e, G.tocsc(), lower, upper

    def stack(self, x: Array, u: Array) -> Array:
        """z of states (N + 1, n) and controls (N, m)."""
        return np.concatenate([x.ravel(), u.ravel()])

    def split(self, z: Array) -> tuple[Array, Array]:
        """States (N + 1, n) and controls (N, m) of z."""
        N, n, m = self.dimensions
        return z[: (N + 1) * n].reshape(N + 1, n), z[(N + 1) * n :].reshape(N, m)

    def residuals(self, answer: "Solution") -> "Residuals":
        """How far the answer is from a solution; stationarity and complementarity are NaN without multipliers."""
        P, c, E, e, G, lower, upper = self.sparse
        z = self.stack(answer.x, answer.u)
        v = G @ z
        feasibility = max(np.abs(E @ z - e).max(), np.maximum(lower - v, v - upper).max(), 0.0)
        if answer.y is None:
            return Residuals(float("nan"), float(feasibility), float("nan"))
        # The multipliers of the equalities follow from those of the bounds: backwards through the dynamics they make
        # the gradient in every state zero, so that what is left over is in the controls.
        gx, gu = self.split(P @ z + c + G.T @ answer.y)
        left = np.empty_like(gu)
        costate = gx[-1]
        for k in range(len(left) - 1, -1, -1):
            left[k] = gu[k] + self.B[k].T @ costate
            costate = gx[k] + self.A[k].T @ costate
        gap = np.where(answer.y > 0, upper - v, v - lower)
        product = np.where(answer.y == 0, 0.0, np.abs(answer.y) * np.abs(gap))
        return Residuals(float(np.abs(left).max()), float(feasibility), float(product.max()))


@dataclass(frozen=True)
class Solution:
    """An answer: x (N + 1, n), u (N, m), and if known y, the multipliers of the rows of G, > 0 at the upper side."""

    x: Array
    u: Array
    y: Array | None = None


@dataclass(frozen=True)
class Residuals:
    """Largest violations: gradient in the controls, constraints, multiplier times distance to the bound."""

    stationarity: float
    feasibility: float
    complementarity: float


class Linearisation:
    """From a trajectory and a measurement to the Qp, by CasADi's own evaluation of the transcription."""

    def __init__(self, transcription: Transcription, parameters: Array) -> None:
        self._t = transcription
        self._parameters = parameters
        self._stages = transcription.linearise.map(transcription.steps)
        self._lengths = np.diff(transcription.times)

    def __call__(self, x: Array, u: Array, stages: Array, measured: Array) -> Qp:
        """Qp at the trajectory x (N + 1, nx), u (N, nu) with stages' parameters (N + 1, stage_size)."""
        t, s = self._t, self._t.statement
        N, n, m = t.steps, s.ndx, s.nu
        common = np.tile(self._parameters[:, None], (1, N))
        raw = self._stages(x[:-1].T, u.T, x[1:].T, stages[:-1].T, common, self._lengths[None, :], t.gains.T)
        A, B, b, Q, S, R, q, r = (np.array(o).T for o in raw)
        Q_end, q_end = (np.array(o).ravel() for o in t.linearise_terminal(x[-1], stages[-1], self._parameters))
        bounds, shift = s.bounds, s.nx - n
        here = x[:, list(bounds.states)]
        lower, upper = np.tile(bounds.u_lower, (N, 1)), np.tile(bounds.u_upper, (N, 1))
        lower[0], upper[0] = first_bounds(t, measured)
        return Qp(
            A.reshape(N, n, n),
            B.reshape(N, n, m),
            b,
            np.concatenate([Q.reshape(N, n, n), Q_end.reshape(1, n, n)]),
            S.reshape(N, m, n),
            R.reshape(N, m, m),
            np.concatenate([q, q_end[None]]),
            r,
            np.array(t.difference(x[0], measured)).ravel(),
            lower - u,
            upper - u,
            bounds.x_lower - here,
            bounds.x_upper - here,
            np.array(bounds.states, dtype=int) - shift,
        )


def first_bounds(transcription: Transcription, measured: Array) -> tuple[Array, Array]:
    """Bounds of the first control, shape (nu,) each: tighter where the command that it causes is bounded as well."""
    bounds = transcription.bounds
    if bounds.lag is None:
        return bounds.u_lower, bounds.u_upper
    here = measured[list(bounds.states)]
    lower, upper = (bounds.x_lower - here) / bounds.lag, (bounds.x_upper - here) / bounds.lag
    return np.maximum(bounds.u_lower, lower), np.minimum(bounds.u_upper, upper)
