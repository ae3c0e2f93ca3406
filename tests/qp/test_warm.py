"""Problems that change slowly: a warm start gives the answer of a cold start, and not always by the interior point."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from judge import TOLERANCE, kkt_errors
from problems import Problem, random_problem
from shapes import Shape, random_shape
from solver import Solver, Status

LENGTH = 40
AGREEMENT = 1e-6


def _drift(rng: np.random.Generator, problem: Problem) -> Iterator[Problem]:
    """The cost moves slowly between two random ones, with a jump half way; all else stays."""
    target = {name: problem[name] + 0.3 * rng.standard_normal(problem[name].shape) for name in ("q", "r")}
    for i in range(LENGTH):
        share = i / LENGTH + 0.5 * (i >= LENGTH // 2)
        yield problem | {name: (1.0 - share) * problem[name] + share * target[name] for name in target}


def _check(folder: Path, shape: Shape, problems: list[Problem], *, shift: bool = False) -> int:
    """Compare warm with cold answers; how many of the warm solves needed the interior point."""
    solver = Solver(folder, shape.pattern)
    warm = []
    for problem in problems:
        warm.append(solver.solve(problem, cold=False))
        if shift:
            solver.shift()
    for got, problem in zip(warm, problems, strict=True):
        expected = solver.solve(problem)
        assert got.status == expected.status == Status.OK
        assert kkt_errors(shape, problem, got).worst < TOLERANCE
        assert abs(got.objective - expected.objective) <= AGREEMENT * (1.0 + abs(expected.objective))
        if np.linalg.eigvalsh(problem["R"]).min() > 1e-3:  # unique enough to be compared
            np.testing.assert_allclose(got.u, expected.u, rtol=0.0, atol=1e-5)
    return sum(answer.iterations > 0 for answer in warm)


def test_warm_equals_cold(tmp_path: Path, mixed: Shape) -> None:
    rng = np.random.default_rng(0)
    problems = list(_drift(rng, random_problem(rng, mixed, "plain")))
    assert _check(tmp_path, mixed, problems) <= LENGTH // 8


@pytest.mark.parametrize("seed", range(2))
def test_warm_equals_cold_in_any_shape(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([7, seed])
    shape = random_shape(rng, large=False)
    _check(tmp_path, shape, list(_drift(rng, random_problem(rng, shape, "plain"))))


def test_unrelated_problems(tmp_path: Path, mixed: Shape) -> None:
    """A warm start from something quite different changes no answer."""
    rng = np.random.default_rng(9)
    kinds = ("tight", "plain", "saturated", "degenerate") * 5
    _check(tmp_path, mixed, [random_problem(rng, mixed, kind) for kind in kinds], shift=True)
