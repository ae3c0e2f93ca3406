"""Scenario: a closed loop with large steps of the reference, recorded, so that every solver is given the same problems.

The loop is flown by the accurate solution of each quadratic programme, on the problem's own dynamics in small steps.
What is kept of each sample is what a real-time iteration is given: the trajectory to linearise at, the parameters of
the stages and the measured state. No solver decides what another one has to solve.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from aerotact.bench.problems import Problem
from aerotact.bench.qp import Linearisation
from aerotact.bench.reference import Reference, solve_exactly
from aerotact.ports import Array

SUBSTEP = 0.002  # s, of the plant
TOUCH = 0.5  # N, from which a sample counts as contact


@dataclass(frozen=True)
class Sample:
    """One problem.

    Attributes:
        x, u: trajectory to linearise at, (N + 1, nx), (N, nu).
        stages: parameters, (N + 1, stage_size).
        measured: state, (nx,).
        reference: accurate solution.
        saturated: a bound is active in it.
        contact: the tool touches in the measured state.
    """

    x: Array
    u: Array
    stages: Array
    measured: Array
    reference: Reference
    saturated: bool
    contact: bool

    def first_control(self, change: Array) -> Array:
        """First control (nu,) of a change (N, nu)."""
        return self.u[0] + change[0]


def record(
    problem: Problem, samples: int, seed: int, progress: Callable[[int], None] = lambda done: None
) -> list[Sample]:
    """Fly the loop and keep its samples."""
    t = problem.transcription
    rng = np.random.default_rng(seed)
    linearise = Linearisation(t, problem.parameters)
    plant, move = _plant(problem), t.retract.map(t.steps + 1)
    measured = problem.start.copy()
    x, u = np.tile(measured, (t.steps + 1, 1)), np.zeros((t.steps, t.statement.nu))
    stages = np.zeros((t.steps + 1, t.statement.stage_size))
    active: Array | None = None
    kept = []
    for index in range(samples):
        if index % problem.hold == 0:
            stages = np.tile(problem.draw(rng), (t.steps + 1, 1))
        reference = solve_exactly(linearise(x, u, stages, measured), active)
        active = reference.active
        touches = problem.contact is not None and problem.contact(measured) > TOUCH
        kept.append(Sample(x, u, stages, measured, reference, bool(active.any()), touches))
        x = np.array(move(x.T, reference.solution.x.T)).T
        u = u + reference.solution.u
        measured = np.array(plant(measured, u[0], stages[0])).ravel()
        progress(index + 1)
    return kept


def _plant(problem: Problem) -> ca.Function:
    """(x, u, stage) -> x one period later: the problem's dynamics in small Runge-Kutta steps of order four."""
    s = problem.transcription.statement
    x, u, stage = ca.SX.sym("x", s.nx), ca.SX.sym("u", s.nu), ca.SX.sym("stage", s.stage_size)
    count = max(round(1 / (problem.rate * SUBSTEP)), 1)
    h = 1 / problem.rate / count
    k1 = s.derivative(x, u, stage)
    k2 = s.derivative(x + h / 2 * k1, u, stage)
    k3 = s.derivative(x + h / 2 * k2, u, stage)
    k4 = s.derivative(x + h * k3, u, stage)
    step = ca.Function("step", [x, u, stage], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    first, held, seen = ca.MX.sym("x", s.nx), ca.MX.sym("u", s.nu), ca.MX.sym("stage", s.stage_size)
    last = first
    for _ in range(count):
        last = step(last, held, seen)
    return ca.Function("plant", [first, held, seen], [last])
