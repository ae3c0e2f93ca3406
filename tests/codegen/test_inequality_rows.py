"""Inequality rows of a problem: the compiled iteration, run to convergence, finds what IPOPT finds."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import native
import numpy as np
import pytest

from aerotact.bench.problems import make_problem
from aerotact.codegen.rti_project import rti_project
from aerotact.mpc.constraints import Rows
from aerotact.mpc.transcription import Transcription, transcribe
from aerotact.ports import Array

STEPS, ITERATIONS = 6, 40
STAGE = (0.4, 0.1, 0.05, 1.0, 0.0, 0.0, 0.0)
TERMINAL = 0.2  # s
CALLER = """
#include <stdio.h>
#include "bench_h_rti.h"
static bench_h_rti rti;
int main(void)
{
    const double x[BENCH_H_NX] = {%s};
    const double stage[BENCH_H_NP] = {%s};
    bench_h_qp_settings settings;
    int i, k, status = 0;
    bench_h_rti_init(&rti);
    bench_h_qp_default_settings(&settings);
    bench_h_rti_start(&rti, x);
    for (k = 0; k <= BENCH_H_STEPS; ++k)
        for (i = 0; i < BENCH_H_NP; ++i)
            rti.stage[k][i] = stage[i];
    for (i = 0; i < %d; ++i) {
        bench_h_rti_prepare(&rti, NULL);
        status |= (int)bench_h_rti_feedback(&rti, x, &settings);
    }
    printf("%%d", status);
    for (i = 0; i < (BENCH_H_STEPS + 1) * BENCH_H_NX; ++i)
        printf(" %%.17g", rti.x[0][i]);
    for (i = 0; i < BENCH_H_STEPS * BENCH_H_NU; ++i)
        printf(" %%.17g", rti.u[0][i]);
    return 0;
}
"""


def _rows(linear: float, quadratic: float) -> Rows:
    """Forward speed and climb below a linear function of the distance to the reference; a constant lower limit."""

    def build(x, stage):
        return ca.vertcat(x[7] - 1.5 * (stage[0] - x[0]), x[9] * x[9])

    return Rows(
        build,
        np.array([-np.inf, -1.0]),
        np.array([-0.35, 0.02]),
        np.array([linear, np.inf]),
        np.array([quadratic, 0.0]),
        TERMINAL,
    )


def _compiled(folder: Path, problem: Transcription, start: Array) -> tuple[int, Array, Array]:
    def listed(values):
        return ", ".join(f"{v:.17g}" for v in values)

    printed = native.run(folder, rti_project(problem), CALLER % (listed(start), listed(STAGE), ITERATIONS)).split()
    numbers = np.array(printed[1:], dtype=float)
    states = (STEPS + 1) * problem.statement.nx
    return int(printed[0]), numbers[:states].reshape(STEPS + 1, -1), numbers[states:].reshape(STEPS, -1)


def _penalty(rows: Rows, values: Array, lengths: Array) -> float:
    violation = np.maximum(0, np.maximum(rows.lower - values, values - rows.upper))
    linear = np.where(rows.soft, rows.linear, 0.0)
    return float((lengths[:, None] * (linear * violation + rows.quadratic * violation**2 / 2)).sum())


def _ipopt(t: Transcription, start: Array) -> tuple[Array, Array, float]:
    s = t.statement
    rows, lengths = s.rows, np.append(np.diff(t.times), s.rows.terminal)[1:]
    dx, u = ca.MX.sym("dx", s.ndx, STEPS), ca.MX.sym("u", s.nu, STEPS)
    slack = ca.MX.sym("s", sum(rows.soft), STEPS)
    x, stage = ca.SX.sym("x", s.nx), ca.SX.sym("p", s.stage_size)
    g = ca.Function("g", [x, stage], [rows.build(x, stage)])
    states = [ca.MX(start), *(t.retract(start, dx[:, k]) for k in range(STEPS))]
    cost, equal, unequal = ca.MX(0), [], []
    for k in range(STEPS):
        cost += t.cost(states[k], u[:, k], STAGE, [], np.diff(t.times)[k])
        equal.append(t.difference(states[k + 1], t.step(states[k], u[:, k], STAGE, np.diff(t.times)[k], t.gains[k])))
        values, own = g(states[k + 1], STAGE), 0
        for i, soft in enumerate(rows.soft):
            unequal.append(values[i] - (slack[own, k] if soft else 0))
            if soft:
                cost += lengths[k] * (rows.linear[i] * slack[own, k] + rows.quadratic[i] / 2 * slack[own, k] ** 2)
                own += 1
    cost += t.terminal_cost(states[-1], STAGE, [])
    b = t.bounds
    where = [i - 1 for i in b.states]
    lower, upper = np.full((s.ndx, STEPS), -np.inf), np.full((s.ndx, STEPS), np.inf)
    lower[where], upper[where] = (b.x_lower - start[13:])[:, None], (b.x_upper - start[13:])[:, None]
    low = [lower.ravel(order="F"), np.tile(b.u_lower, STEPS), np.zeros(slack.numel())]
    high = [upper.ravel(order="F"), np.tile(b.u_upper, STEPS), np.full(slack.numel(), np.inf)]
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "bound_relax_factor": 0.0}}
    problem = {"x": ca.veccat(dx, u, slack), "f": cost, "g": ca.veccat(*equal, *unequal)}
    solver = ca.nlpsol("reference", "ipopt", problem, quiet)
    same = np.zeros(s.ndx * STEPS)
    found = solver(
        x0=0.0,
        lbx=np.concatenate(low),
        ubx=np.concatenate(high),
        lbg=np.concatenate([same, np.tile(np.where(rows.soft, -np.inf, rows.lower), STEPS)]),
        ubg=np.concatenate([same, np.tile(rows.upper, STEPS)]),
    )
    assert solver.stats()["success"]
    flat = found["x"].full().ravel()
    moved = [t.retract(start, d).full().ravel() for d in flat[: s.ndx * STEPS].reshape(STEPS, -1)]
    return np.array(moved), flat[s.ndx * STEPS :][: s.nu * STEPS].reshape(STEPS, -1), float(found["f"])


@pytest.mark.parametrize(
    ("linear", "quadratic", "violated"), [(np.inf, 0.0, False), (5000.0, 0.0, False), (1.0, 40.0, True)]
)
def test_hard_and_soft_rows_hold_or_are_paid_for(
    tmp_path: Path, linear: float, quadratic: float, violated: bool
) -> None:
    problem = make_problem("H", STEPS)
    rows = _rows(linear, quadratic)
    t = transcribe(replace(problem.transcription.statement, rows=rows))
    status, x, u = _compiled(tmp_path, t, problem.start)
    assert status == 0
    states, controls, cost = _ipopt(t, problem.start)
    np.testing.assert_allclose(x[1:, :3], states[:, :3], atol=1e-6)
    np.testing.assert_allclose(u[0], controls[0], atol=1e-3)

    symbols = ca.SX.sym("x", 19)
    g = ca.Function("g", [symbols], [rows.build(symbols, ca.DM(STAGE))])
    values = np.array([g(row).full().ravel() for row in x[1:]])
    assert (values[:, 1] <= rows.upper[1] + 1e-7).all()
    assert values[:, 0].max() == pytest.approx(rows.upper[0], abs=1e-6) or violated
    assert (values[:, 0].max() > rows.upper[0] + 1e-3) == violated
    lengths = np.diff(t.times)
    own = sum(float(t.cost(x[k], u[k], STAGE, [], lengths[k])) for k in range(STEPS))
    own += float(t.terminal_cost(x[-1], STAGE, []))
    own += _penalty(rows, values, np.append(lengths, TERMINAL)[1:])
    assert own == pytest.approx(cost, rel=1e-6)
