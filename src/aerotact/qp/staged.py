"""A dense programme whose variables are the states and controls of a horizon, as an OCP QP with that many stages."""

import numpy as np

from aerotact.codegen.qp_structure import FREE, ZERO, QpPattern
from aerotact.exceptions import InputError
from aerotact.ports import Array
from aerotact.qp.dense import OcpQp
from aerotact.qp.programme import DenseProgramme, DenseSolution
from aerotact.qp.solver import QpResult


def staged_qp(programme: DenseProgramme, nx: int, nu: int) -> OcpQp:
    """The programme with x = (x_1, ..., x_N, u_0, ..., u_(N-1)).

    Rows of A are the dynamics, nx a stage: a diagonal matrix times x_(k+1) plus any matrices times x_k and u_k. Rows of
    G belong to one stage each: they and the cost couple nothing but x_k and u_k.

    Args:
        programme: with N (nx + nu) variables.
        nx, nu: states and controls.

    Raises:
        InputError: the programme is not of this form.
    """
    stages = _Stages(programme, nx, nu)
    n = stages.steps
    data = {**stages.dynamics(), **stages.cost(), **stages.bounds()}
    rows = stages.general_rows()
    count = max((len(r) for r in rows), default=0)
    if count:
        general = {"C": np.zeros((n + 1, count, nx)), "D": np.zeros((n, count, nu))}
        sides = {"lg": np.full((n + 1, count), -np.inf), "ug": np.full((n + 1, count), np.inf)}
        for k, own in enumerate(rows):
            for place, row in enumerate(own):
                general["C"][k, place] = programme.G[row, stages.x[k]] if k else 0.0
                if k < n:
                    general["D"][k, place] = programme.G[row, stages.u[k]]
                sides["ug"][k, place] = programme.h[row]
        data |= general | sides
    grids = {name: np.any(data[name] != 0.0, axis=0) for name in ("A", "B", "Q", "R", "S")}
    pattern = QpPattern(
        nx=nx,
        nu=nu,
        steps=n,
        bounded=stages.bounded,
        general=count,
        **{name: np.where(grid, FREE, ZERO).tolist() for name, grid in grids.items()},
    )

    def recover(found: QpResult) -> DenseSolution:
        x = np.concatenate([found.x[1:].ravel(), found.u.ravel()])
        z, z_box = np.zeros(programme.h.size), np.zeros(x.size)
        for k, own in enumerate(rows):
            z[own] = found.y[k, nu + len(stages.bounded) :][: len(own)]
        for k in range(n):
            z_box[stages.u[k]] = found.y[k, :nu]
            z_box[stages.x[k + 1][list(stages.bounded)]] = found.y[k + 1, nu : nu + len(stages.bounded)]
        y = -found.pi.ravel() / stages.leading
        return programme.judge(found.status, x, z, y, z_box, found.iterations)

    return OcpQp(pattern, data, recover)


class _Stages:
    """Where the parts of the stages are.

    Attributes:
        steps: N.
        x, u: indices of x_k (1..N; x[0] is empty) and of u_k.
        leading: coefficient of x_(k+1) in each row of the dynamics, (N nx,).
        bounded: states that have a bound in any stage.
    """

    def __init__(self, programme: DenseProgramme, nx: int, nu: int) -> None:
        self._p, self._nx, self._nu = programme, nx, nu
        size = programme.q.size
        self.steps = size // (nx + nu)
        if size != self.steps * (nx + nu) or programme.b.size != self.steps * nx:
            raise InputError(
                f"{size} variables and {programme.b.size} equalities; valid for {nx} states and {nu} controls: "
                f"N ({nx} + {nu}) and N {nx}"
            )
        index = np.arange(size)
        states, controls = np.split(index, [self.steps * nx])
        self.x = [index[:0], *states.reshape(self.steps, nx)]
        self.u = list(controls.reshape(self.steps, nu))
        self.leading = programme.A[np.arange(self.steps * nx), states]
        finite = np.isfinite(programme.lb[states]) | np.isfinite(programme.ub[states])
        self.bounded = tuple(np.flatnonzero(finite.reshape(self.steps, nx).any(axis=0)).tolist())

    def dynamics(self) -> dict[str, Array]:
        """A, B, b of the header."""
        n, nx, nu = self.steps, self._nx, self._nu
        found = {"A": np.zeros((n, nx, nx)), "B": np.zeros((n, nx, nu)), "b": np.zeros((n, nx))}
        left = self._p.A.copy()
        for k in range(n):
            rows = np.arange(k * nx, (k + 1) * nx)
            scale = -self.leading[rows]
            if not scale.all():
                raise InputError(f"A: rows {rows[0]}..{rows[-1]} lack their x_{k + 1}; valid: rows of the dynamics")
            if k:
                found["A"][k] = left[np.ix_(rows, self.x[k])] / scale[:, None]
            found["B"][k] = left[np.ix_(rows, self.u[k])] / scale[:, None]
            found["b"][k] = -self._p.b[rows] / scale
            left[np.ix_(rows, [*self.x[k], *self.u[k]])] = 0.0
            left[rows, self.x[k + 1]] = 0.0
        if left.any():
            raise InputError(f"A: row {np.argwhere(left)[0][0]} couples more than x_k, u_k and its own x_(k+1)")
        return found

    def cost(self) -> dict[str, Array]:
        """Q, R, S, q, r of the header."""
        n, nx, nu = self.steps, self._nx, self._nu
        found = {"Q": np.zeros((n + 1, nx, nx)), "R": np.zeros((n, nu, nu)), "S": np.zeros((n, nu, nx))}
        linear = {"q": np.zeros((n + 1, nx)), "r": np.zeros((n, nu))}
        left = self._p.P.copy()
        for k in range(n + 1):
            together = [*self.x[k], *(self.u[k] if k < n else [])]
            if k:
                found["Q"][k], linear["q"][k] = left[np.ix_(self.x[k], self.x[k])], self._p.q[self.x[k]]
            if k < n:
                found["R"][k], linear["r"][k] = left[np.ix_(self.u[k], self.u[k])], self._p.q[self.u[k]]
            if 0 < k < n:
                found["S"][k] = left[np.ix_(self.u[k], self.x[k])]
            left[np.ix_(together, together)] = 0.0
        if left.any():
            raise InputError(f"P: entry {np.argwhere(left)[0].tolist()} couples two stages")
        return found | linear

    def bounds(self) -> dict[str, Array]:
        """lbu, ubu and, if any state has bounds, lbx, ubx of the header."""
        u, x = np.array(self.u), np.array(self.x[1:])[:, list(self.bounded)]
        found = {"lbu": self._p.lb[u], "ubu": self._p.ub[u]}
        if self.bounded:
            none = np.full((1, len(self.bounded)), np.inf)
            found["lbx"], found["ubx"] = np.vstack([-none, self._p.lb[x]]), np.vstack([none, self._p.ub[x]])
        return found

    def general_rows(self) -> list[list[int]]:
        """Rows of G by stage."""
        n = self.steps
        stage_of = np.zeros(self._p.q.size, dtype=int)
        for k in range(n):
            stage_of[self.u[k]], stage_of[self.x[k + 1]] = k, k + 1
        found: list[list[int]] = [[] for _ in range(n + 1)]
        for row, values in enumerate(self._p.G):
            stages = set(stage_of[np.flatnonzero(values)].tolist())
            if len(stages) > 1:
                raise InputError(f"G: row {row} couples stages {sorted(stages)}")
            found[stages.pop() if stages else 0].append(row)
        return found
