"""HPIPM on the random problems: an answer that is called right is right, a contradiction that is claimed is there."""

from collections import Counter

import numpy as np
import pytest
from judge import TOLERANCE, feasible, kkt_errors
from problems import KINDS, random_problem
from shapes import random_shape

from aerotact.codegen.linked import find_library
from aerotact.exceptions import LibraryNotFound
from aerotact.qp.solver import QpSolver, QpStatus

SHAPES, EACH = 12, 20
USUAL = {"plain", "tight", "degenerate", "saturated"}


def test_right_answers_and_proven_contradictions() -> None:
    try:
        find_library("hpipm")
    except LibraryNotFound as error:
        pytest.skip(str(error))
    solved: Counter[str] = Counter()
    tried: Counter[str] = Counter()
    for number in range(SHAPES):
        rng = np.random.default_rng([1, number])
        shape = random_shape(rng, False)
        solver = QpSolver(shape.pattern, "hpipm")
        for i in range(EACH):
            kind = KINDS[i % len(KINDS)]
            problem = random_problem(rng, shape, kind)
            solver.reset()
            answer = solver.solve(problem)
            possible = feasible(shape, problem)
            tried[kind if possible else "infeasible"] += 1
            if answer.status is QpStatus.OK:
                assert kkt_errors(shape, problem, answer).worst < TOLERANCE  # type: ignore[arg-type]
                solved[kind] += 1
            elif answer.status is QpStatus.INFEASIBLE:
                assert not possible
                solved["infeasible"] += 1
    assert solved["infeasible"] == tried["infeasible"] > 30
    assert sum(solved[k] for k in USUAL) >= 0.97 * sum(tried[k] for k in USUAL) > 150
    assert solved["badly scaled"] >= 0.6 * tried["badly scaled"]
