"""Failure policy by fault injection: the shifted plan, then the fallback law or hover, then back with a cold start."""

from pathlib import Path

import numpy as np
import pytest
from inspection import Inspected

from aerotact.codegen.mpc_project import mpc_block
from aerotact.codegen.project import limit_function
from aerotact.controller import Status
from aerotact.dynamics.model import Model
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array

OFFSET = 0.01  # m beside hover: the plan moves, and no limit is near


def _settle(mpc: Inspected, steps: int = 3) -> None:
    mpc.measurement["p_WB"][0] += OFFSET
    for _ in range(steps):
        assert mpc.step() is Status.OK


def _predicted(ocp: Ocp, mpc: Inspected, periods: int) -> Array:
    """The command that the last plan has `periods` later: its thrust there, plus lag times its rate there."""
    x, u = mpc.fields["plan_x"], mpc.fields["plan_u"]
    t = periods / ocp.rate
    k = int(np.searchsorted(ocp.times, t + 1e-9, side="right")) - 1
    thrust = [np.interp(t, ocp.times, x[:, 13 + i]) for i in range(ocp.model.rotors)]
    return np.asarray(thrust) + ocp.model.time_constants * u[min(k, ocp.steps - 1)]


def test_bad_measurement_continues_the_plan_then_hovers_then_recovers(ocp: Ocp, mpc: Inspected) -> None:
    allowed = ocp.file.problem.max_failures
    _settle(mpc)
    telemetry = mpc.output["p_WE_r"].copy()
    plan = mpc.fields["plan_x"].copy()
    good = mpc.measurement["v_WB"].copy()
    mpc.measurement["v_WB"][1] = np.nan
    for failure in range(1, allowed + 1):
        assert mpc.step() is Status.BAD_INPUT
        assert mpc.statistics.failures == failure
        np.testing.assert_allclose(mpc.output["thrust_cmd"], _predicted(ocp, mpc, failure), atol=1e-12)
        np.testing.assert_array_equal(mpc.fields["plan_x"], plan)
        np.testing.assert_array_equal(mpc.output["p_WE_r"], telemetry)
    for _ in range(60):
        assert mpc.step() is Status.BAD_INPUT
    np.testing.assert_allclose(mpc.output["thrust_cmd"], ocp.model.robot.hover_thrust, atol=1e-12)
    np.testing.assert_allclose(mpc.fields["limiter"], ocp.model.robot.hover_thrust, atol=1e-9)

    mpc.measurement["v_WB"][:] = good
    assert mpc.step() is Status.OK
    assert mpc.statistics.failures == 0
    fresh = Inspected(ocp)
    fresh.hover(ocp)
    fresh.measurement["p_WB"][0] += OFFSET
    assert fresh.step() is Status.OK
    # nothing of the old trajectory is left: the plan is that of a controller which never flew before
    np.testing.assert_allclose(mpc.fields["plan_x"], fresh.fields["plan_x"], atol=1e-8)


def test_recovery_starts_the_trajectory_anew(ocp: Ocp, mpc: Inspected) -> None:
    _settle(mpc)
    single = mpc.statistics.qp_iterations
    mpc.configure(startup_iterations=4)
    mpc.measurement["v_WB"][1] = np.inf
    assert mpc.step() is Status.BAD_INPUT
    mpc.measurement["v_WB"][1] = 0.0
    mpc.measurement["p_WB"][2] += 0.3  # far enough that each of the programmes has active bounds
    assert mpc.step() is Status.OK
    again = mpc.statistics.qp_iterations
    assert mpc.step() is Status.OK
    assert min(again, mpc.statistics.qp_iterations) > single


def test_plan_continues_past_the_end_of_the_horizon(ocp: Ocp, mpc: Inspected) -> None:
    mpc.configure(max_failures=1000)
    _settle(mpc)
    mpc.measurement["p_WB"][0] = np.nan
    beyond = int(ocp.times[-1] * ocp.rate) + 20
    for failure in range(1, beyond):
        assert mpc.step() is Status.BAD_INPUT
        if failure in (6, 8, 50, 101, beyond - 1):
            np.testing.assert_allclose(mpc.output["thrust_cmd"], _predicted(ocp, mpc, failure), atol=1e-9)


def test_no_plan_yet_means_hover_at_once(ocp: Ocp, mpc: Inspected) -> None:
    mpc.measurement["q_WB"][:] = 0.0
    assert mpc.step() is Status.BAD_INPUT
    np.testing.assert_array_equal(mpc.output["thrust_cmd"], ocp.model.robot.hover_thrust)


def test_zero_virtual_mass_is_refused_and_ends_in_hover(ocp: Ocp, mpc: Inspected) -> None:
    _settle(mpc)
    mpc.parameters["M_EP"][1] = 0.0
    for failure in range(1, ocp.file.problem.max_failures + 1):
        assert mpc.step() is Status.BAD_INPUT
        np.testing.assert_allclose(mpc.output["thrust_cmd"], _predicted(ocp, mpc, failure), atol=1e-12)
    for _ in range(60):
        assert mpc.step() is Status.BAD_INPUT
    np.testing.assert_allclose(mpc.output["thrust_cmd"], ocp.model.robot.hover_thrust, atol=1e-12)
    mpc.parameters["M_EP"][1] = 1.5
    assert mpc.step() is Status.OK


def test_negative_weight_is_refused(ocp: Ocp, mpc: Inspected) -> None:
    _settle(mpc)
    mpc.parameters["weight_rate"][0] = -1e-12
    assert mpc.step() is Status.BAD_INPUT
    mpc.parameters["weight_rate"][0] = 0.0
    assert mpc.step() is Status.OK


@pytest.mark.parametrize("weight", [np.nan, np.inf, 1.1e6])
def test_absurd_weight_is_refused(ocp: Ocp, mpc: Inspected, weight: float) -> None:
    mpc.parameters["weight_thrust"][-1] = weight
    assert mpc.step() is Status.BAD_INPUT


def _push_far(mpc: Inspected) -> None:
    """So far from the reference that thrust bounds are active: the solver has to iterate, and looks at the clock."""
    mpc.measurement["p_WB"][:] += [0.6, -0.5, 0.8]


def test_fallback_law_takes_over_with_its_own_command(ocp: Ocp, mpc: Inspected) -> None:
    _expect_takeover(ocp, mpc)


def test_fallback_law_with_references_that_the_problem_has_not(hexarotor: Model, short_problem: Path) -> None:
    text = short_problem.read_text().replace('"ryll2019_admittance"', '"ryll2019_pose_control"')
    path = short_problem.with_name("other_fallback.toml")
    path.write_text(text)
    ocp = load_ocp(path, hexarotor)
    own = list(ocp.targets.block.reference)
    assert [p.name for p in ocp.reference][len(own) :] == [p.name for p in ocp.fallback.reference]
    mpc = Inspected(ocp)
    mpc.hover(ocp)
    mpc.reference["p_WB_r"][:] += [0.05, -0.02, 0.01]
    _expect_takeover(ocp, mpc)


def _expect_takeover(ocp: Ocp, mpc: Inspected) -> None:
    _push_far(mpc)
    mpc.configure(max_failures=2)
    mpc.break_solver(True)
    law, limit = ocp.fallback, limit_function(mpc_block(ocp).limiter)
    y = law.measurement.pack({p.name: mpc.measurement[p.name] for p in law.measurement})
    r = law.reference.pack({p.name: np.atleast_2d(mpc.reference[p.name])[0] for p in law.reference})
    p = law.parameters.pack({p.name: mpc.parameters[p.name] for p in law.parameters})
    z = law.state.default
    for failure in range(1, 30):
        sent = mpc.fields["limiter"].copy()
        assert mpc.step() is Status.NUMERICAL
        assert mpc.statistics.failures == failure
        z, u = (v.full().ravel() for v in law.step(z, y, r, p))
        command = limit(sent, law.output.unpack(u)["thrust_cmd"])[1].full().ravel()
        np.testing.assert_allclose(mpc.output["thrust_cmd"], command, atol=1e-9)
        np.testing.assert_allclose(mpc.fields["fallback_state"], z, atol=1e-9)
    mpc.break_solver(False)
    assert mpc.step() is Status.OK
    np.testing.assert_array_equal(mpc.fields["fallback_state"], law.state.default)


def test_failed_solves_continue_the_plan(ocp: Ocp, mpc: Inspected) -> None:
    _settle(mpc)
    mpc.break_solver(True)
    _push_far(mpc)
    for failure in range(1, ocp.file.problem.max_failures + 1):
        wanted = _predicted(ocp, mpc, failure)
        assert mpc.step() is Status.NUMERICAL
        assert mpc.statistics.failures == failure
        np.testing.assert_allclose(mpc.output["thrust_cmd"], wanted, atol=1e-9)


def test_deadline_gives_what_there_is(ocp: Ocp, mpc: Inspected) -> None:
    """A late clock ends the iterations: not converged, within the constraints, no failure."""
    _push_far(mpc)
    mpc.configure(deadline=1e9)
    assert mpc.step() is Status.OK
    needed = mpc.statistics.qp_iterations
    mpc.reset()
    mpc.configure(deadline=0.5)  # the clock is late at its second call
    assert mpc.step() is Status.DEADLINE
    assert mpc.statistics.failures == 0
    assert mpc.statistics.qp_iterations < needed
    assert mpc.statistics.qp_feasibility < 1e-4
    command = ocp.command(mpc.fields["plan_x"][0], mpc.fields["plan_u"][0], mpc.fields["stage"][0]).full().ravel()
    np.testing.assert_allclose(mpc.output["thrust_cmd"], command, atol=1e-9)


@pytest.mark.parametrize("iterations", [0, -3])
def test_at_least_one_iteration_is_made(ocp: Ocp, mpc: Inspected, iterations: int) -> None:
    mpc.configure(startup_iterations=iterations, iterations=iterations)
    mpc.measurement["p_WB"][0] += OFFSET
    assert mpc.step() is Status.OK
    assert np.abs(mpc.fields["plan_u"]).max() > 0.1
