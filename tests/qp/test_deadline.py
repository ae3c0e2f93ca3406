"""A clock that runs out: the solver stops at once, with controls that can be applied, and recovers."""

from pathlib import Path

import numpy as np
import pytest
from judge import TOLERANCE, kkt_errors
from problems import random_problem
from shapes import Shape
from solver import Solver, Status


@pytest.mark.parametrize("allowed", [0, 1, 3, 6])
def test_deadline(tmp_path: Path, mixed: Shape, allowed: int) -> None:
    """The clock is read once a factorisation; `allowed` readings are in time."""
    solver = Solver(tmp_path, mixed.pattern)
    readings = 0

    def read(_: object) -> float:
        nonlocal readings
        readings += 1
        return float(readings > allowed)

    clock = solver.ffi.callback("double(void *)", read)
    problem = random_problem(np.random.default_rng(4), mixed, "saturated")
    solver.settings.clock, solver.settings.deadline = clock, 0.5
    answer = solver.solve(problem)
    assert answer.status == Status.DEADLINE
    assert readings == allowed + 1
    assert answer.finite
    assert (answer.u >= problem["lbu"]).all()
    assert (answer.u <= problem["ubu"]).all()
    solver.settings.clock = solver.ffi.NULL
    after = solver.solve(problem, cold=False)
    assert after.status == Status.OK
    assert kkt_errors(mixed, problem, after).worst < TOLERANCE
