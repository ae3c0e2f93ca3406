"""Bad input: every answer is finite, its controls inside their bounds, with the right status; the next one is right."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from judge import TOLERANCE, kkt_errors
from problems import Problem, random_problem
from shapes import Shape
from solver import Solver, Status

OK, MAX_ITERATIONS, INFEASIBLE, NUMERICAL = Status.OK, Status.MAX_ITERATIONS, Status.INFEASIBLE, Status.NUMERICAL
MATRICES = ("A", "B", "Q", "R", "S", "C", "D")
VECTORS = ("b", "q", "r")


@pytest.fixture(scope="module")
def solver(small: Shape, tmp_path_factory: pytest.TempPathFactory) -> Solver:
    return Solver(tmp_path_factory.mktemp("edge"), small.pattern)


def _entry(name: str, value: float) -> Callable[[Problem], None]:
    def spoil(problem: Problem) -> None:
        problem[name].flat[0] = value

    return spoil


def _row(name: str, value: float) -> Callable[[Problem], None]:
    def spoil(problem: Problem) -> None:
        problem[name][3, 0] = value

    return spoil


def _scaled(factor: float, *names: str) -> Callable[[Problem], None]:
    def spoil(problem: Problem) -> None:
        for name in names:
            problem[name] *= factor

    return spoil


def _crossed(problem: Problem) -> None:
    problem["lbu"][2, 0], problem["ubu"][2, 0] = 1.0, -1.0


def _crossed_states(problem: Problem) -> None:
    problem["lbx"][2, 0], problem["ubx"][2, 0] = 1.0, -1.0


def _indefinite(problem: Problem) -> None:
    problem["R"][:] = -np.eye(2)


CASES: dict[str, tuple[Callable[[Problem], None], set[Status]]] = {
    **{f"{v} in {n}": (_entry(n, v), {NUMERICAL}) for n in (*MATRICES, *VECTORS, "x0") for v in (np.nan, np.inf)},
    **{f"nan in {n}": (_row(n, np.nan), {NUMERICAL}) for n in ("lbu", "ubu", "lbx", "ubx", "lg", "ug")},
    **{f"inf in {n}": (_row(n, np.inf), {INFEASIBLE}) for n in ("lbu", "lg")},
    **{f"-inf in {n}": (_row(n, -np.inf), {INFEASIBLE}) for n in ("ubu", "ug")},
    "crossed control bounds": (_crossed, {INFEASIBLE}),
    "crossed state bounds": (_crossed_states, {INFEASIBLE}),
    "no cost": (_scaled(0.0, "Q", "R", "S", "q", "r"), {OK}),
    "linear cost": (_scaled(0.0, "Q", "R", "S"), {OK, MAX_ITERATIONS, NUMERICAL}),
    "far start": (_scaled(1e9, "x0"), {OK, MAX_ITERATIONS, INFEASIBLE, NUMERICAL}),
    "steep cost": (_scaled(1e12, "q"), {OK, MAX_ITERATIONS, NUMERICAL}),
    "indefinite": (_indefinite, {OK, MAX_ITERATIONS, NUMERICAL}),
    "explosive": (_scaled(1e200, "A"), {MAX_ITERATIONS, INFEASIBLE, NUMERICAL}),
}
CROSSED_BOUNDS = {"crossed control bounds", "inf in lbu", "-inf in ubu", "nan in lbu", "nan in ubu"}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(4))
def test_bad_input(solver: Solver, small: Shape, case: str, seed: int) -> None:
    spoil, expected = CASES[case]
    rng = np.random.default_rng([3, seed])
    good = random_problem(rng, small, "plain")
    good["lbu"][:], good["ubu"][:] = -1.0, 1.0
    bad = {name: values.copy() for name, values in good.items()}
    spoil(bad)
    answer = solver.solve(bad, cold=False)
    assert answer.finite
    assert answer.status in expected
    if case not in CROSSED_BOUNDS:
        assert np.abs(answer.u).max() <= 1.0 + 1e-9
    after = solver.solve(good, cold=False)
    assert after.status == OK
    assert kkt_errors(small, good, after).worst < TOLERANCE


def test_forget_and_repeat(solver: Solver, small: Shape) -> None:
    """A cold start gives the same bits whatever was solved before."""
    rng = np.random.default_rng(1)
    first, other = random_problem(rng, small, "tight"), random_problem(rng, small, "saturated")
    once = solver.solve(first)
    solver.solve(other)
    again = solver.solve(first)
    np.testing.assert_array_equal(once.u, again.u)
    np.testing.assert_array_equal(once.y, again.y)


def test_ok_is_within_the_tolerance_asked_for(tmp_path: Path, small: Shape) -> None:
    """Without relaxation a tolerance that rounding forbids is never said to be reached."""
    solver = Solver(tmp_path, small.pattern)
    s = solver.settings
    s.tol_stationarity = s.tol_feasibility = s.tol_complementarity = 1e-19
    s.relaxation = 1.0
    problem = random_problem(np.random.default_rng(2), small, "tight")
    answer = solver.solve(problem)
    assert answer.status in (MAX_ITERATIONS, NUMERICAL)
    assert not answer.relaxed
