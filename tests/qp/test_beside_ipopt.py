"""Objectives of general rows, soft rows and bounds beside those of another solver."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp
from judge import whole
from problems import Problem, random_problem
from shapes import Shape
from solver import Solver, Status

from aerotact.codegen.qp_structure import QpPattern

SHAPES = {
    "hard rows": QpPattern(5, 2, 8, bounded=(1, 4), general=2, soft_bounds=(False, False), soft_rows=(False, False)),
    "soft rows": QpPattern(5, 2, 8, bounded=(1, 4), general=2, soft_bounds=(True, True), soft_rows=(True, True)),
}


def _reference(shape: Shape, problem: Problem) -> float:
    """IPOPT's objective, with a slack for each side of each row that is soft."""
    w = whole(shape, problem)
    soft, n = np.flatnonzero(w.soft), w.c.size
    slacks = soft.size
    H = sp.block_diag([w.P, sp.diags_array(np.tile(w.quadratic[soft], 2))])
    cost = np.concatenate([w.c, np.tile(w.linear[soft], 2)])
    pick = sp.eye_array(w.soft.size, format="csr")[:, soft]
    rows = sp.vstack([sp.hstack([w.E, sp.csr_array((w.e.size, 2 * slacks))]), sp.hstack([w.G, pick, -pick])])
    z = ca.MX.sym("z", n + 2 * slacks)
    product = ca.DM(sp.csc_matrix(rows)) @ z
    value = 0.5 * ca.bilin(ca.DM(sp.csc_matrix(H)), z, z) + ca.dot(ca.DM(cost), z)
    options = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.tol": 1e-10,
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.sb": "yes",
    }
    solver = ca.nlpsol("reference", "ipopt", {"x": z, "f": value, "g": product}, options)
    floor = np.concatenate([np.full(n, -np.inf), np.zeros(2 * slacks)])
    result = solver(lbx=floor, lbg=np.concatenate([w.e, w.lower]), ubg=np.concatenate([w.e, w.upper]))
    assert solver.stats()["success"]
    return float(result["f"])


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("kind", ["plain", "tight", "saturated"])
def test_objective(tmp_path: Path, name: str, kind: str) -> None:
    shape, rng = Shape(SHAPES[name]), np.random.default_rng(6)
    solver = Solver(tmp_path, shape.pattern)
    for _ in range(5):
        problem = random_problem(rng, shape, kind)
        answer = solver.solve(problem)
        assert answer.status == Status.OK
        assert answer.objective == pytest.approx(_reference(shape, problem), rel=1e-6, abs=1e-6)
        assert np.abs(answer.y[:, shape.pattern.nu :]).max() > 0.0  # some of these rows act
