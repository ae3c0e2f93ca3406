"""Random problems of random shapes: the right answer, or the right status, never a number that is not finite."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from judge import TOLERANCE, feasible, kkt_errors
from problems import KINDS, Problem, random_problem
from shapes import Shape, random_shape
from solver import Answer, Solver, Status

QUICK_SHAPES, QUICK_EACH = 12, 20
SHAPES, EACH = 100, 20


def _fault(shape: Shape, problem: Problem, answer: Answer) -> str | None:
    """What is wrong with an answer."""
    if not answer.finite:
        return "not finite"
    if answer.status == Status.OK:
        errors = kkt_errors(shape, problem, answer)
        return None if errors.worst < TOLERANCE else f"OK with {errors}"
    if answer.status == Status.INFEASIBLE:
        return "INFEASIBLE though feasible" if feasible(shape, problem) else None
    return f"{answer.status.name} with residuals {answer.residuals}, feasible: {feasible(shape, problem)}"


def _run(folder: Path, seed: int, number: int, each: int, large: bool) -> None:
    rng = np.random.default_rng([seed, number])
    shape = random_shape(rng, large)
    solver = Solver(folder, shape.pattern)
    statuses: Counter[str] = Counter()
    faults = []
    for i in range(each):
        kind = KINDS[i % len(KINDS)]
        problem = random_problem(rng, shape, kind)
        answer = solver.solve(problem)
        statuses[f"{kind} {answer.status.name}"] += 1
        statuses["relaxed"] += answer.relaxed
        fault = _fault(shape, problem, answer)
        if fault is not None:
            faults.append(f"{kind}, problem {i}: {fault} after {answer.iterations} iterations")
    print(f"counts {seed} {number} {dict(statuses)}")
    assert not faults, "\n".join([repr(shape.pattern), *faults])


@pytest.mark.parametrize("number", range(QUICK_SHAPES))
def test_right_answer_or_right_status(tmp_path: Path, number: int) -> None:
    _run(tmp_path, 1, number, QUICK_EACH, large=False)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(SHAPES))
def test_two_thousand_problems(tmp_path: Path, number: int) -> None:
    _run(tmp_path, 2, number, EACH, large=number % 4 == 0)
