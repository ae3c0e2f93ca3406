"""Dense programmes by the generated C: as one stage and as a horizon, judged by their own optimality conditions."""

import numpy as np
import pytest

from aerotact.exceptions import InputError
from aerotact.ports import Array
from aerotact.qp.dense import OcpQp, dense_qp
from aerotact.qp.programme import DenseProgramme
from aerotact.qp.solver import QpSolver, QpStatus
from aerotact.qp.staged import staged_qp

NX, NU, STEPS = 3, 2, 4


def _random(rng: np.random.Generator, n: int, m: int, p: int) -> DenseProgramme:
    """Convex and feasible, with some constraints active at the solution."""
    J, inside = rng.normal(size=(n, n)), rng.uniform(-0.5, 0.5, size=n)
    G, A = rng.normal(size=(m, n)), rng.normal(size=(p, n))
    lb = np.where(rng.random(n) < 0.3, -np.inf, -0.6)
    return DenseProgramme.of(J.T @ J, rng.normal(size=n) * 3, G, G @ inside + 0.1, A, A @ inside, lb, np.full(n, 0.8))


def _horizon(rng: np.random.Generator) -> DenseProgramme:
    """A feasible horizon as one dense programme: dynamics with -2 x_(k+1), bounded controls, rows within stages."""
    n = STEPS * (NX + NU)
    J = np.zeros((n, n))
    A, b = np.zeros((STEPS * NX, n)), 0.3 * rng.normal(size=STEPS * NX)
    G = np.zeros((STEPS + 1, n))
    for k in range(STEPS):
        rows, u = np.arange(k * NX, (k + 1) * NX), STEPS * NX + k * NU + np.arange(NU)
        A[rows, rows] = -2.0
        A[np.ix_(rows, u)] = rng.normal(size=(NX, NU))
        stage = [*u, *(rows - NX)] if k else [*u]
        if k:
            A[np.ix_(rows, rows - NX)] = 2.0 * np.eye(NX) + 0.2 * rng.normal(size=(NX, NX))
        J[np.ix_(stage, stage)] = rng.normal(size=(len(stage), len(stage)))
        G[k, u] = rng.normal(size=NU)
    last = np.arange((STEPS - 1) * NX, STEPS * NX)
    J[last, last] = 1.0
    G[STEPS, last[0]] = 1.0
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    lb[STEPS * NX :], ub[STEPS * NX :] = -0.2, 0.3
    ub[2 : STEPS * NX : NX] = 5.0
    h = np.full(STEPS + 1, 0.1)
    h[STEPS] = 5.0
    return DenseProgramme.of(J.T @ J, rng.normal(size=n), G, h, A, b, lb, ub)


@pytest.mark.parametrize(("n", "m", "p"), [(4, 0, 0), (5, 6, 0), (6, 5, 2)])
def test_random_programmes_are_solved(n: int, m: int, p: int) -> None:
    rng = np.random.default_rng(n)
    solver: QpSolver | None = None
    active = 0
    for _ in range(25):
        problem = dense_qp(_random(rng, n, m, p))
        solver = solver or QpSolver(problem.pattern)
        solver.reset()
        found = problem.solve(solver)
        assert found.status is QpStatus.OK
        assert found.within(1e-6)
        assert (found.z >= -1e-12).all()
        active += np.any(np.abs(np.concatenate([found.z, found.z_box])) > 1e-6)
    assert active > 10


def test_solution_by_hand() -> None:
    # The point of x + y = 1 next to (2, 0) with x <= 0.5
    programme = DenseProgramme.of(np.eye(2), [-2.0, 0.0], A=[[1.0, 1.0]], b=[1.0], ub=[0.5, np.inf])
    found = dense_qp(programme).solve()
    np.testing.assert_allclose(found.x, [0.5, 0.5], atol=1e-7)
    np.testing.assert_allclose(found.y, [-0.5], atol=1e-7)
    np.testing.assert_allclose(found.z_box, [2.0, 0.0], atol=1e-7)


def test_contradiction_is_infeasible() -> None:
    programme = DenseProgramme.of(np.eye(2), [1.0, 1.0], G=[[1.0, 1.0]], h=[-3.0], lb=[-1.0, -1.0])
    found = dense_qp(programme).solve()
    assert found.status is QpStatus.INFEASIBLE
    assert not found.within(1e-3)


def test_judge_sees_each_fault() -> None:
    programme = DenseProgramme.of(np.eye(2), [-2.0, 0.0], [[0.0, 1.0]], [np.inf], [[1.0, 1.0]], [1.0], ub=[0.5, np.inf])

    def judge(x: list[float], y: float, z_box: list[float], z: float = 0.0) -> tuple[float, float, float]:
        j = programme.judge(QpStatus.OK, np.array(x), np.array([z]), np.array([y]), np.array(z_box))
        return j.primal, j.dual, j.gap

    assert judge([0.5, 0.5], -0.5, [2.0, 0.0]) == pytest.approx((0, 0, 0))
    assert judge([0.5, 0.4], -0.5, [2.0, 0.0]) == pytest.approx((0.1, 0.1, 0.09))
    assert judge([0.5, 0.5], -0.5, [1.0, 0.0])[1:] == pytest.approx((1.0, 0.5))
    assert judge([0.5, 0.5], -0.5, [2.0, 0.1])[1] == pytest.approx(0.1)  # of a bound that is not there
    assert judge([0.5, 0.5], -0.6, [2.1, 0.0], z=0.1)[1] == pytest.approx(0.1)  # of a row that is not there
    assert not programme.judge(QpStatus.OK, np.full(2, np.nan), np.zeros(1), np.zeros(1), np.zeros(2)).within(1.0)


def test_horizon_has_the_same_solution_as_one_stage() -> None:
    rng = np.random.default_rng(5)
    solvers: dict[str, QpSolver] = {}

    def solved(kind: str, problem: OcpQp) -> Array:
        solver = solvers.setdefault(kind, QpSolver(problem.pattern))
        found = problem.solve(solver)
        assert found.status is QpStatus.OK
        assert found.within(1e-6)
        return found.x

    for _ in range(10):
        programme = _horizon(rng)
        staged = staged_qp(programme, NX, NU)
        assert staged.pattern.steps == STEPS
        assert staged.pattern.bounded == (2,)
        np.testing.assert_allclose(solved("staged", staged), solved("dense", dense_qp(programme)), atol=1e-5)


def test_what_is_no_horizon_is_named() -> None:
    good = _horizon(np.random.default_rng(0))
    fields = {name: getattr(good, name) for name in ("P", "q", "G", "h", "A", "b", "lb", "ub")}

    def spoilt(name: str, row: int, column: int, value: float) -> DenseProgramme:
        matrix = fields[name].copy()
        matrix[row, column] = value
        return DenseProgramme.of(**{**fields, name: matrix})

    with pytest.raises(InputError, match=r"20 variables and 12 equalities; valid for 4 states"):
        staged_qp(good, 4, 2)
    with pytest.raises(InputError, match=r"P: entry \[0, 5\] couples two stages"):
        staged_qp(spoilt("P", 0, 5, 1.0), NX, NU)
    with pytest.raises(InputError, match=r"A: row 1 couples more than"):
        staged_qp(spoilt("A", 1, 11, 1.0), NX, NU)
    with pytest.raises(InputError, match=r"A: rows 0\.\.2 lack their x_1"):
        staged_qp(spoilt("A", 0, 0, 0.0), NX, NU)
    with pytest.raises(InputError, match=r"G: row 4 couples stages \[1, 4\]"):
        staged_qp(spoilt("G", 4, 0, 1.0), NX, NU)


def test_sizes_that_do_not_fit_are_named() -> None:
    with pytest.raises(InputError, match=r"G has shape \(1, 3\); valid for q, h, b of sizes 2, 1, 0: \(1, 2\)"):
        DenseProgramme.of(np.eye(2), [0.0, 0.0], [[1.0, 2.0, 3.0]], [1.0])
    solver = QpSolver(dense_qp(DenseProgramme.of(np.eye(2), [0.0, 0.0])).pattern)
    with pytest.raises(InputError, match="lbu: 3 numbers; valid: 2"):
        solver.solve({"lbu": np.zeros(3)})
    with pytest.raises(Exception, match="unknown field 'cost'"):
        solver.solve({"cost": np.zeros(3)})
