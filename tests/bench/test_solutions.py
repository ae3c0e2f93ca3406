"""Everybody solves the same quadratic programme; the reference faces solvers that share no code with it."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from aerotact.bench.peers.acados_peer import AcadosPeer, Setting, acados_template
from aerotact.bench.peers.aerotact_peer import AerotactPeer
from aerotact.bench.peers.casadi_peer import CasadiPeer
from aerotact.bench.peers.osqp_peer import OsqpPeer
from aerotact.bench.peers.peer import Absent
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Linearisation, Qp, Solution
from aerotact.bench.reference import solve_exactly
from aerotact.bench.scenario import Sample, record

SOME = slice(0, None, 6)


def _error(problem: Problem, sample: Sample, u0: np.ndarray) -> float:
    wanted = sample.first_control(sample.reference.solution.u)
    return float(np.abs((u0 - wanted) / problem.control_range).max())


def test_references_satisfy_the_conditions_of_optimality(samples: list[Sample], qps: list[Qp]) -> None:
    assert samples
    assert any(s.saturated for s in samples)
    for sample, qp in zip(samples, qps, strict=True):
        residuals = qp.residuals(sample.reference.solution)
        assert residuals.stationarity < 1e-9
        assert residuals.feasibility < 1e-9
        assert residuals.complementarity < 1e-9


def test_the_reference_does_not_depend_on_the_guess(samples: list[Sample], qps: list[Qp]) -> None:
    for sample, qp in zip(samples[SOME], qps[SOME], strict=True):
        cold = solve_exactly(qp)
        assert np.allclose(cold.solution.u, sample.reference.solution.u, atol=1e-8)


def test_residuals_tell_a_wrong_answer(samples: list[Sample], qps: list[Qp]) -> None:
    sample, qp = samples[3], qps[3]
    right = sample.reference.solution
    assert qp.residuals(Solution(right.x, right.u + 1e-3, right.y)).feasibility > 1e-5
    assert qp.residuals(Solution(right.x, right.u + 1.0, right.y)).stationarity > 1e-9
    assert np.isnan(qp.residuals(Solution(right.x, right.u)).stationarity)


def test_another_active_set_solver_finds_the_same(problem: Problem, samples: list[Sample]) -> None:
    peer = CasadiPeer(problem, "daqp")
    for sample in samples[SOME]:
        assert _error(problem, sample, peer.solve(sample).u0) < 1e-7


def test_iterations_converge_to_the_solution_of_ipopt(problem: Problem, samples: list[Sample]) -> None:
    t = problem.transcription
    near = np.array([0.1, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0, 1.0])[: t.statement.stage_size]
    x, u = np.tile(problem.start, (t.steps + 1, 1)), np.zeros((t.steps, t.statement.nu))
    sample = replace(samples[0], x=x, u=u, stages=np.tile(near, (t.steps + 1, 1)), measured=problem.start)
    converged = CasadiPeer(problem, "ipopt").solve(sample)
    assert converged.usable
    linearise = Linearisation(t, problem.parameters)
    for _ in range(40):
        change = solve_exactly(linearise(x, u, sample.stages, sample.measured)).solution
        x = np.array([np.array(t.retract(a, d)).ravel() for a, d in zip(x, change.x, strict=True)])
        u = u + change.u
    assert np.abs(u[0]).max() > 0.1
    assert np.abs((u[0] - converged.u0) / problem.control_range).max() < 1e-5


def test_the_generated_solver_finds_the_same(problem: Problem, samples: list[Sample]) -> None:
    peer = AerotactPeer(problem)
    for sample in samples:
        answer = peer.solve(sample)
        assert answer.usable
        assert answer.prepare > 0
        assert answer.total == pytest.approx(answer.prepare + answer.feedback)
        assert _error(problem, sample, answer.u0) < 2e-3
    assert peer.sizes["workspace"] > 0


def test_hpipm_finds_the_same(problem: Problem, samples: list[Sample]) -> None:
    try:
        peer = AerotactPeer(problem, "hpipm", tolerance=1e-8)
    except Absent as absent:
        pytest.skip(str(absent))
    assert peer.name == "hpipm 1e-8"
    for sample in samples:
        answer = peer.solve(sample)
        assert answer.usable
        assert answer.work > 0
        assert _error(problem, sample, answer.u0) < 2e-3


@pytest.mark.skipif(importlib.util.find_spec("osqp") is None, reason="osqp is not installed")
def test_osqp_finds_the_same(problem: Problem, samples: list[Sample]) -> None:
    peer = OsqpPeer(problem, 1e-7)
    answers = [peer.solve(sample) for sample in samples[SOME]]
    solved = [(a, s) for a, s in zip(answers, samples[SOME], strict=True) if a.usable]
    assert solved
    assert all(_error(problem, s, a.u0) < 1e-2 for a, s in solved)


def test_acados_solves_the_same_in_both_forms(problem: Problem, samples: list[Sample], qps: list[Qp]) -> None:
    try:
        acados_template()
    except Absent as absent:
        pytest.skip(str(absent))
    tangent = AcadosPeer(problem, Setting("tangent", 3, "SPEED"))
    quaternion = AcadosPeer(problem, Setting("quaternion", 6, "SPEED"))
    for sample, qp in zip(samples, qps, strict=True):
        answer = tangent.solve(sample)
        assert _error(problem, sample, answer.u0) < 5e-3
        assert answer.solution is not None
        residuals = qp.residuals(answer.solution)
        assert max(residuals.stationarity, residuals.feasibility, residuals.complementarity) < 1e-5
        own = quaternion.solve(sample)
        assert own.own is not None
        exact = solve_exactly(own.own, sample.reference.active)
        assert np.abs((own.u0 - sample.first_control(exact.solution.u)) / problem.control_range).max() < 5e-3


def test_acados_that_is_absent_gives_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ACADOS_SOURCE_DIR", raising=False)
    with pytest.raises(Absent, match=r"^acados: skipped, ACADOS_SOURCE_DIR is not set$"):
        acados_template()
    monkeypatch.setenv("ACADOS_SOURCE_DIR", "/nowhere")
    with pytest.raises(Absent, match=r"^acados: skipped, /nowhere/lib is missing[^\n]*$"):
        acados_template()


def test_the_same_seed_gives_the_same_samples(problem: Problem, samples: list[Sample]) -> None:
    again = record(problem, 3, seed=3)
    for a, b in zip(again, samples, strict=False):
        assert np.array_equal(a.measured, b.measured)
        assert np.array_equal(a.x, b.x)
    other = record(problem, 1, seed=4)
    assert not np.array_equal(other[0].stages, samples[0].stages)
