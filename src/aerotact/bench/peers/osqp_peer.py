"""OSQP from PyPI on the same quadratic programme; its own solve time, warm started, without set-up or linearisation."""

import importlib
from typing import Any

import numpy as np
import scipy.sparse as sp

from aerotact.bench.peers.peer import Absent, Answer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Linearisation, Solution
from aerotact.bench.scenario import Sample
from aerotact.ports import Array

ITERATIONS = 20000


class OsqpPeer:
    """OSQP at one tolerance, absolute and relative."""

    every = 25
    build_seconds = 0.0

    def __init__(self, problem: Problem, tolerance: float) -> None:
        """Import it.

        Raises:
            Absent: it is not installed.
        """
        try:
            osqp: Any = importlib.import_module("osqp")
        except ImportError as error:
            raise Absent("osqp: skipped, it is not installed: pip install 'aerotact[bench]'") from error
        self._module, self._tolerance = osqp, tolerance
        self._linearise = Linearisation(problem.transcription, problem.parameters)
        self.name = f"osqp {tolerance:.0e}".replace("e-0", "e-")
        self.settings = f"eps_abs = eps_rel = {tolerance:g}, max_iter {ITERATIONS}, warm start, solve time only"
        self.versions = {"osqp": str(osqp.__version__)}
        self.sizes: dict[str, int] = {}
        self._last: tuple[Array, Array] | None = None

    def reset(self) -> None:
        """No warm start."""
        self._last = None

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        """One quadratic programme."""
        qp = self._linearise(sample.x, sample.u, sample.stages, sample.measured)
        P, c, E, e, G, lower, upper = qp.sparse
        solver: Any = self._module.OSQP()
        solver.setup(
            P=sp.triu(P, format="csc"),
            q=c,
            A=sp.vstack([E, G], format="csc"),
            l=np.concatenate([e, lower]),
            u=np.concatenate([e, upper]),
            eps_abs=self._tolerance,
            eps_rel=self._tolerance,
            max_iter=ITERATIONS,
            verbose=False,
        )
        if self._last is not None:
            solver.warm_start(x=self._last[0], y=self._last[1])
        found = solver.solve()
        total = 1e6 * float(found.info.solve_time)
        usable = found.x is not None and bool(np.isfinite(found.x).all())
        z = found.x if usable else np.zeros(len(c))
        y = found.y if usable else np.zeros(len(e) + len(lower))
        self._last = (z, y) if usable else None
        x, u = qp.split(np.array(z))
        nan = float("nan")
        solution = Solution(x, u, np.array(y[len(e) :])) if full else None
        return Answer(sample.u[0] + u[0], nan, nan, total, usable and found.info.status_val in (1, 2), solution)
