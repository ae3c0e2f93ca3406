"""The compiled real-time iteration, iterated to convergence, finds what IPOPT finds; its programmes are solved."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from inspection import Inspected

from aerotact.controller import Status
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

ITERATIONS = 60


@dataclass(frozen=True)
class Case:
    """Where the robot is, m and m/s from hover, and whether bounds of thrust and of thrust rate are active."""

    offset: tuple[float, float, float]
    velocity: tuple[float, float, float]
    tilt: float
    thrust_active: bool
    rate_active: bool


CASES = {
    "no bound": Case((0.002, -0.001, 0.001), (0.0, 0.0, 0.0), 0.002, False, False),
    "rates": Case((0.02, -0.02, 0.01), (0.0, 0.0, 0.0), 0.02, False, True),
    "rates and thrusts": Case((0.3, -0.25, 0.4), (0.3, 0.1, 0.5), 0.15, True, True),
}


def _start(mpc: Inspected, ocp: Ocp, case: Case) -> None:
    mpc.measurement["p_WB"][:] += case.offset
    mpc.measurement["v_WB"][:] = case.velocity
    mpc.measurement["q_WB"][:] = [np.cos(case.tilt / 2), np.sin(case.tilt / 2), 0.0, 0.0]


def _ipopt(ocp: Ocp, stage: Array, x0: Array) -> tuple[Array, Array, float]:
    """States, controls and cost of the same problem by IPOPT, in changes about a robot that stays where it is."""
    model, N = ocp.model, ocp.steps
    ndx, nu = model.tangent_size, model.control.size
    rest = x0.copy()
    rest[7:13] = 0.0
    parameters = ocp.targets.block.parameters.default
    intervals = np.diff(ocp.times)
    a, b = ca.SX.sym("a", x0.size), ca.SX.sym("b", x0.size)
    local = ca.Function("local", [a, b], [model.local(a, b)])
    dx, u = ca.MX.sym("dx", ndx, N), ca.MX.sym("u", nu, N)
    states = [ca.MX(x0), *(ocp.retract(rest, dx[:, k]) for k in range(N))]
    cost, gaps = ca.MX(0), []
    for k in range(N):
        cost += ocp.cost(states[k], u[:, k], stage[k], parameters, intervals[k])
        gaps.append(local(states[k + 1], ocp.step(states[k], u[:, k], stage[k], intervals[k], ocp.gains[k])))
    cost += ocp.terminal_cost(states[N], stage[N], parameters)
    bounds = ocp.bounds
    thrust_lower, thrust_upper = np.full((ndx, N), -np.inf), np.full((ndx, N), np.inf)
    where = [i - 1 for i in bounds.states]
    thrust_lower[where] = (bounds.x_lower - x0[13:])[:, None]
    thrust_upper[where] = (bounds.x_upper - x0[13:])[:, None]
    rate_lower, rate_upper = np.tile(bounds.u_lower, (N, 1)), np.tile(bounds.u_upper, (N, 1))
    tau = model.time_constants
    rate_lower[0] = np.maximum(rate_lower[0], (bounds.x_lower - x0[13:]) / tau)
    rate_upper[0] = np.minimum(rate_upper[0], (bounds.x_upper - x0[13:]) / tau)
    problem = {"x": ca.veccat(dx, u), "f": cost, "g": ca.veccat(*gaps)}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.tol": 1e-10, "ipopt.sb": "yes"}
    solver = ca.nlpsol("reference", "ipopt", problem, {**options, "ipopt.bound_relax_factor": 0.0})
    lower = np.concatenate([thrust_lower.ravel(order="F"), rate_lower.ravel()])
    upper = np.concatenate([thrust_upper.ravel(order="F"), rate_upper.ravel()])
    found = solver(x0=0.0, lbx=lower, ubx=upper, lbg=0.0, ubg=0.0)
    assert solver.stats()["success"], solver.stats()["return_status"]
    flat = found["x"].full().ravel()
    changes, controls = flat[: ndx * N].reshape(N, ndx), flat[ndx * N :].reshape(N, nu)
    return np.array([ocp.retract(rest, d).full().ravel() for d in changes]), controls, float(found["f"])


@pytest.mark.parametrize("name", sorted(CASES))
def test_converged_iteration_equals_ipopt(ocp: Ocp, mpc: Inspected, name: str) -> None:
    case = CASES[name]
    _start(mpc, ocp, case)
    mpc.configure(startup_iterations=ITERATIONS)
    assert mpc.step() is Status.OK
    x0 = mpc.fields["plan_x"][0]
    states, controls, cost = _ipopt(ocp, mpc.fields["stage"], x0)

    expected = ocp.command(x0, controls[0], mpc.fields["stage"][0]).full().ravel()
    np.testing.assert_allclose(mpc.output["thrust_cmd"], expected, atol=1e-4)
    np.testing.assert_allclose(mpc.fields["plan_x"][1:, :3], states[:, :3], atol=1e-5)
    assert _cost(ocp, mpc) == pytest.approx(cost, rel=1e-6)

    bounds, thrust, rate = ocp.bounds, mpc.fields["plan_x"][1:, 13:], mpc.fields["plan_u"]
    reached = (thrust < bounds.x_lower + 1e-5) | (thrust > bounds.x_upper - 1e-5)
    assert reached.any() == case.thrust_active
    assert ((rate < bounds.u_lower + 1e-3) | (rate > bounds.u_upper - 1e-3)).any() == case.rate_active
    assert (thrust > bounds.x_lower - 1e-6).all()
    assert (thrust < bounds.x_upper + 1e-6).all()


def _cost(ocp: Ocp, mpc: Inspected) -> float:
    x, u, stage = (mpc.fields[n] for n in ("plan_x", "plan_u", "stage"))
    parameters = ocp.targets.block.parameters.default
    running = sum(float(ocp.cost(x[k], u[k], stage[k], parameters, h)) for k, h in enumerate(np.diff(ocp.times)))
    return running + float(ocp.terminal_cost(x[-1], stage[-1], parameters))


@pytest.mark.parametrize("name", sorted(CASES))
def test_quadratic_programme_is_solved(ocp: Ocp, mpc: Inspected, name: str) -> None:
    _start(mpc, ocp, CASES[name])
    mpc.configure(startup_iterations=1)
    assert mpc.step() is Status.OK
    statistics = mpc.statistics
    assert (statistics.qp_iterations > 0) == CASES[name].rate_active
    assert statistics.qp_feasibility < 1e-8 * np.abs(mpc.fields["qp_solution.u"]).max()  # the solver's is relative
    f = {**mpc.fields, **mpc.programme}
    largest = max(np.abs(f["q"]).max(), np.abs(f["r"]).max())
    assert statistics.qp_stationarity < 1e-6 * largest
    assert statistics.qp_complementarity < 1e-6 * largest

    # the same programme, stacked, by another solver
    N, ndx, nu = ocp.steps, ocp.model.tangent_size, ocp.model.control.size
    total = N * (ndx + nu)
    H, g = np.zeros((total, total)), np.zeros(total)
    A, b = np.zeros((N * ndx, total)), np.zeros(N * ndx)
    lower, upper = np.full(total, -np.inf), np.full(total, np.inf)
    for k in range(N):
        x, ahead = slice((k - 1) * ndx, k * ndx), slice(k * ndx, (k + 1) * ndx)
        u = slice(N * ndx + k * nu, N * ndx + (k + 1) * nu)
        H[u, u], g[u] = f["R"][k], f["r"][k]
        lower[u], upper[u] = f["lbu"][k], f["ubu"][k]
        A[ahead, ahead], A[ahead, u], b[ahead] = np.eye(ndx), -f["B"][k], f["b"][k]
        if k > 0:
            H[x, x], g[x] = f["Q"][k], f["q"][k]
            H[u, x], H[x, u] = f["S"][k], f["S"][k].T
            A[ahead, x] = -f["A"][k]
        where = [i - 1 for i in ocp.bounds.states]
        lower[ahead][where], upper[ahead][where] = f["lbx"][k + 1], f["ubx"][k + 1]
        if k == N - 1:
            H[ahead, ahead], g[ahead] = f["Q"][N], f["q"][N]
    H = (H + H.T) / 2
    H, A = ca.sparsify(ca.DM(H)), ca.sparsify(ca.DM(A))
    programme = {"h": H.sparsity(), "a": A.sparsity()}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "bound_relax_factor": 0.0}}
    solver = ca.conic("other", "nlpsol", programme, {"nlpsol": "ipopt", "nlpsol_options": quiet})
    found = solver(h=H, g=g, a=A, lba=b, uba=b, lbx=lower, ubx=upper)
    assert solver.stats()["success"]
    ours = np.concatenate([f["qp_solution.x"][1:].ravel(), f["qp_solution.u"].ravel()])
    assert float(found["cost"]) == pytest.approx(float(ca.bilin(H, ours, ours)) / 2 + g @ ours, rel=1e-6)
    first = slice(N * ndx, N * ndx + nu)
    tau = ocp.model.time_constants  # from a rate to the command that causes it
    np.testing.assert_allclose(tau * f["qp_solution.u"][0], tau * found["x"].full().ravel()[first], atol=1e-4)


def test_programme_is_casadis_linearisation_of_every_stage(ocp: Ocp, mpc: Inspected) -> None:
    _start(mpc, ocp, CASES["rates and thrusts"])
    mpc.configure(startup_iterations=1)
    assert mpc.step() is Status.OK
    f = {**mpc.fields, **mpc.programme}
    # a cold start stays where the robot is, at rest, under the thrusts of now
    x = np.tile(f["plan_x"][0], (ocp.steps + 1, 1))
    x[1:, 7:13] = 0.0
    parameters = ocp.targets.block.parameters.default
    for k, h in enumerate(np.diff(ocp.times)):
        expected = ocp.linearise(x[k], np.zeros(ocp.model.rotors), x[k + 1], f["stage"][k], parameters, h, ocp.gains[k])
        for name, value in zip(("A", "B", "b", "Q", "S", "R", "q", "r"), expected, strict=True):
            np.testing.assert_allclose(f[name][k].ravel(), value.full().ravel(), rtol=1e-10, atol=1e-12, err_msg=name)
    Q, q = (v.full().ravel() for v in ocp.linearise_terminal(x[-1], f["stage"][-1], parameters))
    np.testing.assert_allclose(f["Q"][-1].ravel(), Q, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(f["q"][-1], q, rtol=1e-10, atol=1e-12)
