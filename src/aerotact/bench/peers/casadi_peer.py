"""CasADi's own solvers on the same problem, interpreted: one iteration of sqpmethod, and IPOPT converged.

Both see the problem in changes about the sample's trajectory, so that one Gauss-Newton iteration of sqpmethod solves
the common quadratic programme. IPOPT goes on to the solution of the nonlinear programme: its first control shows what
a single real-time iteration leaves undone, which no solver of the quadratic programme can better.
"""

import time
from typing import Any

import casadi as ca
import numpy as np

from aerotact.bench.peers.peer import Answer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Solution, first_bounds
from aerotact.bench.scenario import Sample
from aerotact.ports import Array

_SQP = {
    "max_iter": 1,
    "max_iter_ls": 0,
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
    "print_time": False,
    "error_on_fail": False,
}
_QP: dict[str, dict[str, Any]] = {
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    "daqp": {"error_on_fail": False},
}
_IPOPT = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "constr_viol_tol": 1e-10, "max_iter": 300},
}


class CasadiPeer:
    """sqpmethod with the solver "qrqp" or "daqp" of its quadratic programme, or "ipopt"."""

    def __init__(self, problem: Problem, solver: str) -> None:
        self._problem, self._t = problem, problem.transcription
        self._linear = solver != "ipopt"
        self.name = f"casadi {solver}" if self._linear else "ipopt"
        self.every = 25 if self._linear else 50
        self.settings = (
            f"sqpmethod, one Gauss-Newton iteration, {solver}" if self._linear else "converged, tolerance 1e-10"
        )
        self.versions = {"casadi": ca.CasadiMeta.version()}
        self.sizes: dict[str, int] = {}
        begin = time.perf_counter()
        nlp, hessian = _programme(problem)
        options: Any = _IPOPT
        if self._linear:
            options = {**_SQP, "hess_lag": hessian, "qpsol": solver, "qpsol_options": _QP[solver]}
        self._solver = ca.nlpsol("solver", "sqpmethod" if self._linear else "ipopt", nlp, options)
        self.build_seconds = time.perf_counter() - begin

    def reset(self) -> None:
        """Nothing is kept."""

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        """One iteration, or all of them."""
        t, s = self._t, self._t.statement
        b, N, n, m = s.bounds, t.steps, s.ndx, s.nu
        start = np.array(t.difference(sample.x[0], sample.measured)).ravel()
        x_lower, x_upper = np.full((N + 1, n), -np.inf), np.full((N + 1, n), np.inf)
        index = np.array(b.states, dtype=int)
        x_lower[1:, index - (s.nx - n)] = b.x_lower - sample.x[1:, index]
        x_upper[1:, index - (s.nx - n)] = b.x_upper - sample.x[1:, index]
        x_lower[0] = x_upper[0] = start
        u_lower, u_upper = np.tile(b.u_lower, (N, 1)), np.tile(b.u_upper, (N, 1))
        u_lower[0], u_upper[0] = first_bounds(t, sample.measured)
        arguments: dict[str, Any] = {
            "x0": np.zeros((N + 1) * n + N * m),
            "p": np.concatenate([sample.x.ravel(), sample.u.ravel(), sample.stages.ravel()]),
            "lbx": np.concatenate([x_lower.ravel(), (u_lower - sample.u).ravel()]),
            "ubx": np.concatenate([x_upper.ravel(), (u_upper - sample.u).ravel()]),
            "lbg": 0,
            "ubg": 0,
        }
        begin = time.perf_counter()
        found = self._solver(**arguments)
        total = 1e6 * (time.perf_counter() - begin)
        z, y = np.array(found["x"]).ravel(), np.array(found["lam_x"]).ravel()
        x, u = z[: (N + 1) * n].reshape(N + 1, n), z[(N + 1) * n :].reshape(N, m)
        multipliers = np.concatenate(
            [y[(N + 1) * n :], y[: (N + 1) * n].reshape(N + 1, n)[1:, index - (s.nx - n)].ravel()]
        )
        nan = float("nan")
        usable = bool(np.isfinite(z).all()) and (self._linear or self._solver.stats()["success"])
        solution = Solution(x, u, multipliers) if full and self._linear else None
        return Answer(sample.u[0] + u[0], nan, nan, total, usable, solution)


def _programme(problem: Problem) -> tuple[dict[str, Any], Any]:
    """The nonlinear programme in changes about a trajectory, and its Gauss-Newton Hessian at zero change."""
    t, s = problem.transcription, problem.transcription.statement
    N, n, m = t.steps, s.ndx, s.nu
    dx, du = ca.MX.sym("dx", n, N + 1), ca.MX.sym("du", m, N)
    x, u = ca.MX.sym("x", s.nx, N + 1), ca.MX.sym("u", m, N)
    stages = ca.MX.sym("stages", s.stage_size, N + 1)
    lengths, common = np.diff(t.times), ca.DM(problem.parameters)
    cost: Any = 0
    gaps, blocks, corners, ends = [], [], [], []
    for k in range(N):
        moved, control = t.retract(x[:, k], dx[:, k]), u[:, k] + du[:, k]
        landed = t.step(moved, control, stages[:, k], lengths[k], t.gains[k])
        gaps.append(t.difference(x[:, k + 1], landed) - dx[:, k + 1])
        cost += t.cost(moved, control, stages[:, k], common, lengths[k])
        cost += s.damping * lengths[k] / 2 * (ca.sumsqr(dx[:, k]) + ca.sumsqr(du[:, k]))
        _, _, _, Q, S, R, _, _ = t.linearise(
            x[:, k], u[:, k], x[:, k + 1], stages[:, k], common, lengths[k], t.gains[k]
        )
        blocks.append(ca.reshape(Q, n, n))
        corners.append(ca.reshape(S, n, m).T)
        ends.append(ca.reshape(R, m, m))
    cost += t.terminal_cost(t.retract(x[:, N], dx[:, N]), stages[:, N], common)
    cost += s.damping / 2 * ca.sumsqr(dx[:, N])
    blocks.append(ca.reshape(t.linearise_terminal(x[:, N], stages[:, N], common)[0], n, n))
    corner = ca.horzcat(ca.diagcat(*corners), ca.MX(N * m, n))
    H = ca.blockcat([[ca.diagcat(*blocks), corner.T], [corner, ca.diagcat(*ends)]])
    z = ca.vertcat(ca.vec(dx), ca.vec(du))
    p = ca.vertcat(ca.vec(x), ca.vec(u), ca.vec(stages))
    g = ca.vertcat(*gaps)
    weight, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    names = ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
    hessian = ca.Function("hess_lag", [z, p, weight, multipliers], [weight * H], *names)
    return {"x": z, "p": p, "f": cost, "g": g}, hessian


def error_of_one_iteration(sample: Sample, converged: Array, width: Array) -> float:
    """Largest difference between the first control of one exact iteration and the converged one, by `width`."""
    return float(np.abs((sample.first_control(sample.reference.solution.u) - converged) / width).max())
