"""Problems of tilting rotors: bounds, targets, and a closed loop that uses all limits and breaks none."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from holding import hold
from inspection import Inspected

from aerotact.controller import Status
from aerotact.dynamics.model import Model
from aerotact.exceptions import MissingCapability
from aerotact.mpc import ocp as ocp_module
from aerotact.mpc.constraints import make_bounds
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array

PROBLEM = """
[problem]
doc = "pose of the tool with limits of thrusts and tilts"
needs = ["six_axis_wrench", "tool", "tilt"]
times = [0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.08, 0.11, 0.14, 0.20, 0.26, 0.32]
rate = 200.0
fallback = "hold"
terminal = 0.3
[residuals.tool_pose]
weight = { position = 400.0, attitude = 40.0 }
[residuals.twist]
weight = { linear = 8.0, angular = 4.0 }
[residuals.thrust]
weight = 1e-3
[residuals.tilt]
weight = 0.02
[residuals.rate]
weight = 1e-6
[residuals.tilt_rate]
weight = 2e-4
[constraints]
thrust = "hard"
thrust_rate = "hard"
tilt = "hard"
tilt_rate = "hard"
"""
SUBSTEPS = 5


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(ocp_module, "laws", lambda: {"hold": hold})
    path = tmp_path / "tilting_pose.toml"
    path.write_text(PROBLEM)
    return path


@pytest.fixture
def tilting_ocp(problem: Path, tilting: Model) -> Ocp:
    return load_ocp(problem, tilting)


def _plant(model: Model, period: float) -> ca.Function:
    """State a period later under held commands and a constant wrench, by Runge-Kutta steps of a millisecond."""
    x, command, wrench = (ca.SX.sym(n, size) for n, size in (("x", 25), ("c", 12), ("w", 6)))
    h, after = period / SUBSTEPS, x
    for _ in range(SUBSTEPS):
        k1 = model.derivative(after, model.rates(after, command), wrench)
        k2 = model.derivative(after + h / 2 * k1, model.rates(after + h / 2 * k1, command), wrench)
        k3 = model.derivative(after + h / 2 * k2, model.rates(after + h / 2 * k2, command), wrench)
        k4 = model.derivative(after + h * k3, model.rates(after + h * k3, command), wrench)
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("plant", [x, command, wrench], [after])


def _fly(ocp: Ocp, mpc: Inspected, x: Array, seconds: float, wrench: Array) -> tuple[Array, Array, Array]:
    """States, commands and the rates that these caused, one row a period; the wrench is told to the controller."""
    model, plant = ocp.model, _plant(ocp.model, 1.0 / ocp.rate)
    mpc.measurement["f_ext_W"][:], mpc.measurement["tau_ext_B"][:] = np.split(wrench, 2)
    states, commands, rates = [], [], []
    for _ in range(int(seconds * ocp.rate)):
        for name in ("p_WB", "q_WB", "v_WB", "w_B"):
            mpc.measurement[name][:] = model.state.unpack(x)[name]
        assert mpc.step() is Status.OK
        command = np.concatenate([mpc.output["thrust_cmd"], mpc.output["tilt_cmd"]])
        rates.append(model.rates(ca.DM(x), ca.DM(command)).full().ravel())
        x = plant(x, command, wrench).full().ravel()
        x[3:7] /= np.linalg.norm(x[3:7])
        states.append(x)
        commands.append(command)
    return np.array(states), np.array(commands), np.array(rates)


def test_bounds_are_those_of_the_robot(tilting: Model) -> None:
    all_of_them = make_bounds(tilting, ["thrust", "thrust_rate", "tilt", "tilt_rate"])
    assert all_of_them.states == tuple(range(13, 25))
    np.testing.assert_array_equal(
        all_of_them.x_lower, np.concatenate([tilting.tilt_limits[0], tilting.thrust_limits[0]])
    )
    np.testing.assert_array_equal(
        all_of_them.u_upper, np.concatenate([tilting.tilt_rate_limits[1], tilting.thrust_rate_limits[1]])
    )
    np.testing.assert_array_equal(all_of_them.lag, [0.048] * 6 + [0.02] * 6)
    half = make_bounds(tilting, ["tilt", "thrust_rate"])
    assert np.isinf(half.x_upper[6:]).all()
    assert np.isfinite(half.x_upper[:6]).all()
    assert np.isinf(half.u_lower[:6]).all()
    none = make_bounds(tilting, ["tilt_rate"])
    assert none.states == ()
    assert none.lag is None


def test_constraints_of_tilts_need_tilts(problem: Path, hexarotor: Model) -> None:
    problem.write_text(problem.read_text().replace(', "tilt"]', "]").replace("[residuals.tilt]\nweight = 0.02\n", ""))
    problem.write_text(problem.read_text().replace("[residuals.tilt_rate]\nweight = 2e-4\n", ""))
    with pytest.raises(MissingCapability, match=r"problem 'tilting_pose' needs tilt, which robot 'tilt_hex'"):
        load_ocp(problem, hexarotor)


def test_held_commands_act_through_the_lags(tilting_ocp: Ocp) -> None:
    tau = np.array([0.048] * 6 + [0.02] * 6)
    np.testing.assert_allclose(tilting_ocp.gains[0], tau * (1 - np.exp(-0.005 / tau)), rtol=1e-14)
    np.testing.assert_allclose(
        tilting_ocp.gains[1:], np.diff(tilting_ocp.times)[1:, None] * np.ones((1, 12)), rtol=1e-14
    )


def test_trim_balances_the_wrench(tilting_ocp: Ocp) -> None:
    """At the reference, with the trim as actuators, nothing accelerates."""
    block, model = tilting_ocp.targets.block, tilting_ocp.model
    wrench = {"f_ext_W": [5.0, -3.0, 2.0], "tau_ext_B": [0.3, -0.5, 0.2]}
    s = model.state.unpack(model.hover_state)
    y = block.measurement.pack({**{n: s[n] for n in ("p_WB", "q_WB", "tilt", "thrust")}, **wrench})
    _, u = block.step(block.state.default, y, block.reference.default, block.parameters.default)
    stages = np.reshape(u.full().ravel()[25 : 25 + len(tilting_ocp.times) * tilting_ocp.targets.stage.size], (14, -1))
    for stage in stages:
        trim = tilting_ocp.targets.stage.unpack(stage)
        x = model.state.pack({**s, "tilt": trim["tilt_trim"], "thrust": trim["thrust_trim"]})
        rates = model.function(x, np.zeros(12), model.disturbance.pack(wrench)).full().ravel()
        np.testing.assert_allclose(rates, 0.0, atol=1e-6)
    assert np.abs(trim["tilt_trim"]).max() > 0.1


def test_closed_loop_uses_its_limits_and_breaks_none(tilting_ocp: Ocp) -> None:
    """Half a metre from the reference and pushed: limits bind, none is broken, and the tool ends without an error."""
    model, mpc = tilting_ocp.model, Inspected(tilting_ocp)
    mpc.hover(tilting_ocp)
    x = model.hover_state.copy()
    x[:3] += [0.5, -0.2, 0.1]
    wrench = np.array([4.0, 3.0, -2.0, 0.2, -0.3, 0.1])
    states, commands, rates = _fly(tilting_ocp, mpc, x, 8.0, wrench)
    known = {
        "thrust": (model.thrust_limits, model.thrust_rate_limits),
        "tilt": (model.tilt_limits, model.tilt_rate_limits),
    }
    for name, (limits, rate_limits) in known.items():
        actual = states[:, model.state.slice(name)]
        command = commands[:, model.commands.slice(f"{name}_cmd")]
        rate = rates[:, model.control.slice(f"{name}_rate")]
        for values, (lower, upper) in ((actual, limits), (command, limits), (rate, rate_limits)):
            slack = 1e-6 * (upper - lower)
            assert (values >= lower - slack).all(), name
            assert (values <= upper + slack).all(), name
        assert np.abs(rate).max() > 0.999 * rate_limits[1][0], f"the rate of {name} must be used up"
    np.testing.assert_allclose(
        states[-1, 13:], mpc.fields["limiter"], atol=1e-5
    )  # modelled actuators are the true ones
    p_WE, q_WE = (v.full().ravel() for v in model.tool_pose(ca.DM(states[-1])))
    np.testing.assert_allclose(p_WE, mpc.reference["p_WE_d"][-1], atol=1e-4)
    assert abs(q_WE @ mpc.reference["q_WE_d"][-1]) == pytest.approx(1.0, abs=1e-7)


def test_failures_lead_to_the_plan_and_then_to_the_law(tilting_ocp: Ocp) -> None:
    model, mpc = tilting_ocp.model, Inspected(tilting_ocp)
    mpc.hover(tilting_ocp)
    x = model.hover_state.copy()
    x[:3] += [0.1, 0.0, 0.0]
    _fly(tilting_ocp, mpc, x, 0.1, np.zeros(6))
    plan_x, plan_u, period = mpc.fields["plan_x"].copy(), mpc.fields["plan_u"].copy(), 1.0 / tilting_ocp.rate
    sent = mpc.fields["limiter"].copy()
    mpc.measurement["p_WB"][:] = np.nan
    assert mpc.step() is Status.BAD_INPUT
    expected = model.command(ca.DM(plan_x[1]), ca.DM(plan_u[1])).full().ravel()
    output = np.concatenate([mpc.output["thrust_cmd"], mpc.output["tilt_cmd"]])
    np.testing.assert_allclose(output, expected, atol=1e-6)
    for _ in range(400):
        assert mpc.step() is Status.BAD_INPUT
    np.testing.assert_allclose(mpc.output["thrust_cmd"], model.robot.hover_thrust, atol=1e-9)
    np.testing.assert_allclose(mpc.output["tilt_cmd"], 0.0, atol=1e-9)
    assert period > 0
    assert np.abs(sent[:6]).max() > 1e-3
