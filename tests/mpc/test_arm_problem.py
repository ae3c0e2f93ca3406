"""Problems of robots with compliant arms: against IPOPT, C against CasADi, hostile inputs, failures, limits."""

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from inspection import Inspected

from aerotact.controller import Status
from aerotact.dynamics.actuators import SPIN, TILT
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.reduced import Reduced
from aerotact.exceptions import MissingCapability, ProblemError
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array
from aerotact.robot import load_robot

ROOT = Path(__file__).parents[2]
PROBLEM = "dual_arm_tools"
NAMES = ("dual_arm_standard", "dual_arm_long_reach")
ITERATIONS = 60


@cache
def _ocp(name: str) -> Ocp:
    return load_ocp(PROBLEM, model_of(load_robot(ROOT / "models" / name)))


@pytest.fixture(scope="module", params=NAMES)
def arms(request: pytest.FixtureRequest) -> Ocp:
    return _ocp(request.param)


def _model(ocp: Ocp) -> Reduced:
    assert isinstance(ocp.model, Reduced)
    return ocp.model


def _hover(ocp: Ocp) -> Inspected:
    """At rest in the hover keyframe, as the sensors would tell it."""
    mpc, full = Inspected(ocp), _model(ocp).full
    mpc.hover(ocp)
    said = full.sensed(ca.DM(full.state.pack({"joint": full.hover_joint, "servo": full.hover_servo})))
    said |= {"joint": full.hover_joint}
    for name, value in said.items():
        if name in mpc.measurement:
            mpc.measurement[name][:] = np.ravel(ca.DM(value).full())
    return mpc


def _ipopt(ocp: Ocp, stage: Array, x0: Array) -> tuple[Array, float]:
    """States and cost of the same problem by IPOPT, with a slack for each soft row."""
    s, N = ocp.statement, ocp.steps
    lengths, parameters = np.diff(ocp.times), ocp.targets.block.parameters.default
    a, b, p = ca.SX.sym("a", s.nx), ca.SX.sym("b", s.nx), ca.SX.sym("p", s.stage_size)
    local = ca.Function("local", [a, b], [s.local(a, b)])
    rows = ca.Function("rows", [a, p], [s.rows.build(a, p)])
    rest = np.ravel(ca.DM(ocp.rest(x0)).full())
    dx, u, slack = ca.MX.sym("dx", s.ndx, N), ca.MX.sym("u", s.nu, N), ca.MX.sym("s", s.rows.size, N)
    states = [ca.MX(x0), *(ocp.retract(rest, dx[:, k]) for k in range(N))]
    cost, gaps, below, above = ca.MX(0), [], [], []
    for k in range(N):
        cost += ocp.cost(states[k], u[:, k], stage[k], parameters, lengths[k])
        gaps.append(local(states[k + 1], ocp.step(states[k], u[:, k], stage[k], lengths[k], ocp.gains[k])))
        value, length = rows(states[k + 1], stage[k + 1]), lengths[k + 1] if k + 1 < N else s.rows.terminal
        below.append(value + slack[:, k] - s.rows.lower)
        above.append(s.rows.upper + slack[:, k] - value)
        violated = slack[:, k]
        cost += length * (ca.dot(s.rows.linear, violated) + ca.dot(s.rows.quadratic, violated**2) / 2)
    cost += ocp.terminal_cost(states[N], stage[N], parameters)
    sides = ca.vertcat(*[ca.fmin(v, 1e6) for v in (*below, *above)])
    problem = {"x": ca.veccat(dx, u, slack), "f": cost, "g": ca.veccat(*gaps, sides)}
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.tol": 1e-9, "ipopt.sb": "yes"}
    solver = ca.nlpsol("reference", "ipopt", problem, {**options, "ipopt.bound_relax_factor": 0.0})
    equal, free = s.ndx * N, np.inf
    found = solver(
        x0=np.concatenate([np.zeros(s.ndx * N), np.tile(_model(ocp).hover_control, N), np.zeros(s.rows.size * N)]),
        lbx=np.concatenate([np.full(s.ndx * N, -free), np.tile(s.bounds.u_lower, N), np.zeros(s.rows.size * N)]),
        ubx=np.concatenate([np.full(s.ndx * N, free), np.tile(s.bounds.u_upper, N), np.full(s.rows.size * N, free)]),
        lbg=np.zeros(equal + sides.shape[0]),
        ubg=np.concatenate([np.zeros(equal), np.full(sides.shape[0], free)]),
    )
    assert solver.stats()["success"], solver.stats()["return_status"]
    changes = found["x"].full().ravel()[: s.ndx * N].reshape(N, s.ndx)
    return np.array([ocp.retract(rest, d).full().ravel() for d in changes]), float(found["f"])


@pytest.mark.parametrize("offset", [0.01, 0.2])
def test_converged_iteration_equals_ipopt(arms: Ocp, offset: float) -> None:
    """Near hover nothing is active; 0.2 m away torques and the rows of joints, servos and springs are."""
    mpc = _hover(arms)
    mpc.measurement["p_WB"][:2] += [offset, -offset]
    mpc.configure(startup_iterations=ITERATIONS)
    assert mpc.step() is Status.OK
    states, cost = _ipopt(arms, mpc.fields["stage"], mpc.fields["plan_x"][0])
    u, torque = mpc.fields["plan_u"], _model(arms).control.slice("torque")
    bounds = arms.bounds
    active = np.isclose(u[:, torque], bounds.u_upper[torque]) | np.isclose(u[:, torque], bounds.u_lower[torque])
    assert active.any() == (offset > 0.1)
    np.testing.assert_allclose(mpc.fields["plan_x"][1:, :3], states[:, :3], atol=1e-6)
    joint = _model(arms).state.slice("joint")
    np.testing.assert_allclose(mpc.fields["plan_x"][1:, joint], states[:, joint], atol=1e-5)
    assert cost > 0.0


def test_compiled_command_equals_casadi(arms: Ocp) -> None:
    mpc = _hover(arms)
    mpc.measurement["p_WB"][:] += [0.03, 0.02, -0.02]
    for _ in range(4):
        assert mpc.step() is Status.OK
    sent = arms.command(mpc.fields["plan_x"][0], mpc.fields["plan_u"][0], mpc.fields["stage"][0]).full().ravel()
    for name, value in _model(arms).commands.unpack(sent).items():
        np.testing.assert_allclose(mpc.output[name], value, atol=1e-9)  # within every limit, so nothing is cut


def test_hover_is_kept(arms: Ocp) -> None:
    """What deflects the springs beyond the static load counts as steady after some seconds of `yielding`."""
    mpc, model = _hover(arms), _model(arms)
    for _ in range(100):
        assert mpc.step() is Status.OK
    for port in model.commands:
        np.testing.assert_allclose(mpc.output[port.name], port.default, atol=1e-3)


def test_force_is_felt_through_the_springs(arms: Ocp) -> None:
    """Deflections that a push of 2 N would leave are told as 2 N, and the tool counts as in contact.

    In one period and with hardly a filter: the plan then moves the servos, and the same deflections mean another force.
    """
    model, mpc = _model(arms), _hover(arms)
    mpc.set_parameters({"force_filter": 50.0})
    full, name, n_W = model.full, model.arms[0], np.array([0.0, 0.0, -1.0])
    x = ca.SX(ca.DM(model.hover_state))
    J = ca.evalf(model.tool_jacobian(x)).full()[:, model.passive : model.passive + 4]
    push = J.T @ (2.0 * n_W) / full.stiffness[:4]
    for _ in range(200):
        assert mpc.step() is Status.OK
    mpc.reference[f"f_{name}_d"][:] = -2.0 * n_W
    mpc.measurement["deflection_measured"][:] -= push[[0, 3]]
    assert mpc.step() is Status.OK
    assert mpc.output["force_est"][0] == pytest.approx(2.0, abs=0.1)
    assert mpc.output["pushing"][0] == 1.0


def _within(ocp: Ocp, output: dict[str, Array], before: Array) -> None:
    model = _model(ocp)
    flat = np.concatenate([output[port.name] for port in model.commands])
    assert np.isfinite(flat).all()
    assert model.thrust_limits[0][0] <= output["lift_r"][0] <= model.thrust_limits[1][0]
    assert (np.abs(output["tau_B_r"] - model.hover_torque) <= model.torque_limits + 1e-12).all()
    assert np.abs(output["w_B_r"]).max() <= SPIN
    q = output["q_WB_r"]
    assert np.linalg.norm(q) == pytest.approx(1.0)
    assert 2 * np.arcsin(min(np.hypot(q[1], q[2]), 1.0)) <= TILT + 1e-6
    rate = (output["servo_r"] - before) / model.full.servo_time_constants
    assert (np.abs(rate) <= model.full.servo_rate_limits[1] + 1e-9).all()


def test_hostile_inputs_leave_finite_commands_within_the_limits(arms: Ocp) -> None:
    mpc, rng = _hover(arms), np.random.default_rng(0)
    good = {g: mpc.flat(g).copy() for g in ("measurement", "reference")}
    worst = (np.nan, np.inf, -np.inf, 1e300, 1e7, -1e7, 1e5, 0.0, 1e-300)
    seen = set()
    for step in range(400):
        for group, values in good.items():
            flat = mpc.flat(group)
            flat[: values.size] = values
            if step % 4 == 0:
                flat[rng.integers(values.size)] = worst[rng.integers(len(worst))]
            elif step % 4 == 1:
                flat[: values.size] += 10.0 ** rng.uniform(-3, 4) * rng.normal(size=values.size)
        before = mpc.fields["limiter"].copy()
        seen.add(mpc.step())
        _within(arms, mpc.output, before)
    assert {Status.OK, Status.BAD_INPUT} <= seen
    for group, values in good.items():
        mpc.flat(group)[: values.size] = values
    for _ in range(3):
        status = mpc.step()
    assert status is Status.OK


def test_failed_solves_continue_the_plan_then_the_fallback_law_flies_and_the_servos_stay(arms: Ocp) -> None:
    mpc, model = _hover(arms), _model(arms)
    mpc.measurement["p_WB"][0] += 0.02
    for _ in range(3):
        assert mpc.step() is Status.OK
    mpc.break_solver(True)
    for failure in range(1, arms.file.problem.max_failures + 1):
        before = mpc.fields["limiter"].copy()
        assert mpc.step() is Status.NUMERICAL
        assert mpc.statistics.failures == failure
        _within(arms, mpc.output, before)
    last = mpc.output["servo_r"].copy()
    for _ in range(5):
        assert mpc.step() is Status.NUMERICAL
    np.testing.assert_allclose(mpc.output["servo_r"], last, atol=1e-12)
    # The law leans back towards its place; along z it holds the weight.
    assert mpc.output["lift_r"][0] == pytest.approx(model.hover_thrust, rel=0.05)
    assert mpc.output["q_WB_r"][2] < 0.0
    mpc.break_solver(False)
    assert mpc.step() is Status.OK
    assert mpc.statistics.failures == 0


def test_bounds_and_rows_are_those_of_the_file(arms: Ocp) -> None:
    model, bounds = _model(arms), arms.bounds
    lower, upper = model.control.unpack(bounds.u_lower), model.control.unpack(bounds.u_upper)
    np.testing.assert_array_equal([lower["thrust"], upper["thrust"]], model.thrust_limits)
    np.testing.assert_array_equal(upper["torque"] - model.hover_torque, model.torque_limits)
    np.testing.assert_array_equal([lower["joint_rate"], upper["joint_rate"]], model.servo_rate_limits)
    assert np.isinf([lower["force_rate"], upper["force_rate"]]).all()
    # tilt, joints, servos, torques of the springs, elbows, swing
    assert arms.statement.rows.size == 1 + 3 * model.joints + len(model.arms) + model.passive
    assert all(arms.statement.rows.soft)


def test_a_problem_of_rigid_bodies_says_that_arms_do_not_fit(arms: Ocp, tmp_path: Path) -> None:
    text = arms.path.read_text()
    path = tmp_path / "rigid.toml"
    path.write_text(text.replace("[residuals.base_twist]", "[residuals.twist]"))
    with pytest.raises(MissingCapability, match="rigid_body"):
        load_ocp(path, _model(arms).full)
    path.write_text(text.replace('fallback = "suarez2020_position"', 'fallback = "suarez2020_attitude"'))
    with pytest.raises(ProblemError, match="lift_r"):
        load_ocp(path, _model(arms).full)


def test_residuals_of_joints_that_are_not_there_are_left_out() -> None:
    names = [{p.name for p in _ocp(name).parameters} for name in NAMES]
    assert names[1] - names[0] >= {"weight_swing", "weight_swing_moment"}
    assert not {"weight_swing", "weight_swing_moment"} & names[0]
