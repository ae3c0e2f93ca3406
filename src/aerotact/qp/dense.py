"""A dense programme as an OCP QP of one stage: all variables are controls, all constraints general rows."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern
from aerotact.ports import Array
from aerotact.qp.programme import DenseProgramme, DenseSolution
from aerotact.qp.solver import QpResult, QpSolver


@dataclass(frozen=True)
class OcpQp:
    """An OCP QP that stands for a dense programme.

    Attributes:
        pattern: its size and sparsity.
        data: by the names of the generated header.
        recover: from its solution to that of the dense programme.
    """

    pattern: QpPattern
    data: dict[str, Array]
    recover: Callable[[QpResult], DenseSolution]

    def solve(self, solver: QpSolver | None = None) -> DenseSolution:
        """Solve by the generated C.

        Args:
            solver: for an earlier programme of the same pattern, whose solution then is the warm start; without it, one
                of the back end aerotact is compiled (or taken from the cache).

        Raises:
            CompilerNotFound, CodegenError: as QpSolver.
        """
        return self.recover((solver or QpSolver(self.pattern)).solve(self.data))


def dense_qp(programme: DenseProgramme) -> OcpQp:
    """N = 1 and u_0 = x; the rows of G and of A are general rows, those of A with equal sides.

    The state, which the interface needs, is one number that stays 1.
    """
    n, m, p = programme.q.size, programme.h.size, programme.b.size
    data = {
        "x0": np.ones(1),
        "A": np.ones((1, 1)),
        "Q": np.ones((2, 1)),
        "R": programme.P.ravel(),
        "r": programme.q,
        "lbu": programme.lb,
        "ubu": programme.ub,
    }
    if m + p:
        free = np.full(m + p, np.inf)
        data["D"] = np.vstack([programme.G, programme.A]).ravel()
        data["lg"] = np.stack([np.concatenate([np.full(m, -np.inf), programme.b]), -free])
        data["ug"] = np.stack([np.concatenate([programme.h, programme.b]), free])
    pattern = QpPattern(
        nx=1,
        nu=n,
        steps=1,
        general=m + p,
        A=[[ONE]],
        B=[[ZERO] * n],
        R=np.where(programme.P != 0.0, FREE, ZERO).tolist(),
        S=[[ZERO]] * n,
    )

    def recover(found: QpResult) -> DenseSolution:
        z_box, z, y = np.split(found.y[0], [n, n + m])
        return programme.judge(found.status, found.u[0], z, y, z_box, found.iterations)

    return OcpQp(pattern, data, recover)
