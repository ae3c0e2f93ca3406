import casadi as ca
import numpy as np
import pytest

from aerotact.bench.problems import STIFFNESS, Problem, make_problem
from aerotact.exceptions import InputError, UnknownName

STEP, TOLERANCE = 1e-6, 1e-5


def _somewhere(problem: Problem, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A state off hover, the tip of O in the wall, and a control."""
    s = problem.transcription.statement
    x = np.array(problem.transcription.retract(problem.start, 0.3 * rng.standard_normal(s.ndx))).ravel()
    x[0] = 0.47
    return x, rng.standard_normal(s.nu)


def test_hover_is_an_equilibrium(problem: Problem) -> None:
    s = problem.transcription.statement
    rate = s.derivative(problem.start, np.zeros(s.nu), problem.draw(np.random.default_rng(0)))
    assert np.abs(np.array(ca.evalf(rate))).max() < 1e-9


def test_dimensions_are_those_that_are_documented() -> None:
    for name, expected in (("H", (19, 18, 6, 6)), ("O", (25, 24, 12, 12))):
        s = make_problem(name).transcription.statement
        assert (s.nx, s.ndx, s.nu, len(s.bounds.states)) == expected
        assert make_problem(name).transcription.steps == 20


def test_linearised_dynamics_face_finite_differences(problem: Problem, rng: np.random.Generator) -> None:
    t, s = problem.transcription, problem.transcription.statement
    x, u = _somewhere(problem, rng)
    x_next, _ = _somewhere(problem, rng)
    stage, h, gain = problem.draw(rng), t.times[1], t.gains[0]
    A, B, *_ = t.linearise(x, u, x_next, stage, problem.parameters, h, gain)

    def gap(dx: np.ndarray, du: np.ndarray) -> np.ndarray:
        return np.array(t.difference(x_next, t.step(t.retract(x, dx), u + du, stage, h, gain))).ravel()

    for matrix, size, place in ((A, s.ndx, 0), (B, s.nu, 1)):
        found = np.array(matrix).reshape(s.ndx, size)
        for i in range(size):
            change = [np.zeros(s.ndx), np.zeros(s.nu)]
            change[place][i] = STEP
            column = (gap(*change) - gap(*(-c for c in change))) / (2 * STEP)
            assert np.allclose(found[:, i], column, atol=TOLERANCE * (1 + np.abs(column).max()))


def test_gradients_of_the_cost_face_finite_differences(problem: Problem, rng: np.random.Generator) -> None:
    t, s = problem.transcription, problem.transcription.statement
    x, u = _somewhere(problem, rng)
    stage, h = problem.draw(rng), t.times[1]
    *_, q, r = t.linearise(x, u, x, stage, problem.parameters, h, t.gains[0])
    _, q_end = t.linearise_terminal(x, stage, problem.parameters)

    def difference(cost: object, size: int) -> np.ndarray:
        assert callable(cost)
        return np.array([(cost(STEP * e) - cost(-STEP * e)) / (2 * STEP) for e in np.eye(size)], dtype=float).ravel()

    pairs = (
        (q, difference(lambda d: float(t.cost(t.retract(x, d), u, stage, problem.parameters, h)), s.ndx)),
        (r, difference(lambda d: float(t.cost(x, u + d, stage, problem.parameters, h)), s.nu)),
        (q_end, difference(lambda d: float(t.terminal_cost(t.retract(x, d), stage, problem.parameters)), s.ndx)),
    )
    for found, wanted in pairs:
        assert np.allclose(np.array(found).ravel(), wanted, atol=TOLERANCE * (1 + np.abs(wanted).max()))


def test_the_wall_pushes_back_as_a_spring_does() -> None:
    problem = make_problem("O", 2)
    assert problem.contact is not None
    inside, outside = problem.start.copy(), problem.start.copy()
    inside[0], outside[0] = 0.45 + 0.02, 0.45 - 0.02
    assert problem.contact(inside) == pytest.approx(0.02 * STIFFNESS, rel=1e-3)
    assert problem.contact(outside) < 1e-3
    rate = problem.transcription.statement.derivative(inside, np.zeros(12), problem.draw(np.random.default_rng(0)))
    assert float(ca.evalf(rate)[7]) == pytest.approx(-problem.contact(inside) / 5.0)


def test_an_ocp_file_is_a_problem_too() -> None:
    problem = make_problem("tilt_hex_admittance")
    stage = problem.draw(np.random.default_rng(0))
    assert stage.shape == (problem.transcription.statement.stage_size,)
    assert problem.rate == 100.0


def test_what_is_no_problem_is_refused() -> None:
    with pytest.raises(UnknownName):
        make_problem("no_such_problem")
    with pytest.raises(InputError, match="horizon"):
        make_problem("tilt_hex_admittance", 5)
    with pytest.raises(InputError, match="at least 1"):
        make_problem("H", 0)
