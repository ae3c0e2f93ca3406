"""Targets: the predicted virtual mass-spring-damper, its memory, and the thrust that holds a target."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

FORCE = np.array([1.0, -2.0, 0.5])  # N, on the tool
DEAD = 0.2  # N and N m, the dead zones of the problem


class Prepared:
    """The targets of one step, unpacked."""

    def __init__(
        self, ocp: Ocp, measured: dict[str, Array], wanted: dict[str, Array], state: Array | None = None
    ) -> None:
        block = ocp.targets.block
        z = block.state.default if state is None else state
        y, r = block.measurement.pack(measured), block.reference.pack(wanted)
        after, out = (v.full().ravel() for v in block.step(z, y, r, block.parameters.default))
        values = block.output.unpack(out)
        self.state_after = after
        self.x0 = values["x0"]
        self.stages = [ocp.targets.stage.unpack(row) for row in values["stage"]]

    def over_horizon(self, name: str) -> Array:
        """One stage parameter at every node."""
        return np.array([stage[name] for stage in self.stages])


def _gain(ocp: Ocp, name: str) -> Array:
    parameters = ocp.targets.block.parameters
    return parameters.unpack(parameters.default)[name]


def test_admittance_follows_the_exact_response_over_the_grid(ocp: Ocp) -> None:
    prepared = Prepared(ocp, {"f_tool_W": FORCE}, {})
    felt = FORCE * (np.linalg.norm(FORCE) - DEAD) / np.linalg.norm(FORCE)
    assert len(set(np.round(np.diff(ocp.times), 9))) > 2  # the grid is not uniform
    for axis in range(3):
        M, D, K = (_gain(ocp, name)[axis] for name in ("M_EP", "D_EP", "K_EP"))
        dynamics = np.array([[0.0, 1.0, 0.0], [-K / M, -D / M, felt[axis] / M], [0.0, 0.0, 0.0]])
        exact = np.array([(expm(dynamics * t) @ [0.0, 0.0, 1.0])[:2] for t in ocp.times])
        p = prepared.over_horizon("p_WE_r")[:, axis]
        np.testing.assert_allclose(p - p[0], exact[:, 0], atol=1e-12)
        np.testing.assert_allclose(prepared.over_horizon("v_WE_r")[:, axis], exact[:, 1], atol=1e-12)
        assert np.abs(exact[-1, 0]) > 0.01


@pytest.mark.parametrize("axis", range(3))
def test_rotation_follows_the_nonlinear_response_about_one_axis(ocp: Ocp, axis: int) -> None:
    tau = np.zeros(3)
    tau[axis] = 1.0
    q_d = np.array([1.0, 0.0, 0.0, 0.0])
    prepared = Prepared(ocp, {"tau_tool_W": tau}, {"q_WE_d": np.tile(q_d, len(ocp.times))})
    M, D, K = (_gain(ocp, name)[axis] for name in ("M_ER", "D_ER", "K_ER"))

    def slope(_: float, y: Array) -> list[float]:
        return [y[1], (1.0 - DEAD - D * y[1] - K * np.sin(y[0])) / M]

    exact = solve_ivp(slope, (0.0, ocp.times[-1]), [0.0, 0.0], t_eval=ocp.times, method="LSODA", rtol=1e-10, atol=1e-12)
    q = prepared.over_horizon("q_WE_r")
    angle = 2 * np.arctan2(q[:, 1 + axis], q[:, 0])
    assert angle[-1] > 0.05
    # (28) is the sine of the angle and is taken as linear over each interval
    np.testing.assert_allclose(angle, exact.y[0], atol=2e-4)
    np.testing.assert_allclose(np.delete(q[:, 1:], axis, axis=1), 0.0, atol=1e-15)


def test_memory_continues_where_the_prediction_said(ocp: Ocp) -> None:
    first = Prepared(ocp, {"f_tool_W": FORCE}, {})
    second = Prepared(ocp, {"f_tool_W": FORCE}, {}, first.state_after)
    for name in ("p_WE_r", "v_WE_r", "w_E_r"):
        np.testing.assert_allclose(second.over_horizon(name)[0], first.over_horizon(name)[1], atol=1e-14)
        # one interval of 2 h agrees with two of h where the grid allows it
        np.testing.assert_allclose(second.over_horizon(name)[1:5], first.over_horizon(name)[2:6], atol=1e-12)


def test_wrench_below_the_dead_zone_moves_nothing(ocp: Ocp) -> None:
    prepared = Prepared(ocp, {"f_tool_W": [0.1, 0.0, -0.1], "tau_tool_W": [0.0, 0.15, 0.0]}, {})
    p = prepared.over_horizon("p_WE_r")
    np.testing.assert_allclose(p, np.tile(p[0], (len(p), 1)), atol=1e-12)


def test_state_of_a_solve_is_the_measurement_and_the_modelled_thrust(ocp: Ocp) -> None:
    rng = np.random.default_rng(7)
    thrust = rng.uniform(1.0, 5.0, ocp.model.rotors)
    measured = {"p_WB": [1.0, 2.0, 3.0], "q_WB": [0.0, 1.0, 0.0, 0.0], "v_WB": [4.0, 5.0, 6.0], "w_B": [7.0, 8.0, 9.0]}
    prepared = Prepared(ocp, {**measured, "thrust": thrust}, {})
    np.testing.assert_array_equal(prepared.x0, ocp.model.state.pack({**measured, "thrust": thrust}))


@pytest.mark.parametrize("seed", range(4))
def test_thrust_trim_holds_the_robot_against_the_wrench(ocp: Ocp, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ocp.model
    angle, axis = 0.1, rng.normal(size=3)
    q_WB = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis / np.linalg.norm(axis))])
    x = model.state.pack({"p_WB": rng.normal(size=3), "q_WB": q_WB})
    p_WE, q_WE = (v.full().ravel() for v in model.tool_pose(ca.DM(x)))
    wrench = {"f_ext_W": rng.uniform(-1.0, 1.0, 3), "tau_ext_B": rng.uniform(-0.1, 0.1, 3)}
    nodes = len(ocp.times)
    prepared = Prepared(ocp, wrench, {"p_WE_d": np.tile(p_WE, nodes), "q_WE_d": np.tile(q_WE, nodes)})
    lower, upper = model.thrust_limits
    for trim in prepared.over_horizon("thrust_trim"):
        assert ((trim > lower) & (trim < upper)).all()
        held = model.state.pack({**model.state.unpack(x), "thrust": trim})
        rates = model.function(held, np.zeros(model.rotors), model.disturbance.pack(wrench)).full().ravel()
        np.testing.assert_allclose(rates, 0.0, atol=1e-9)


def test_thrust_trim_stays_within_the_limits(ocp: Ocp) -> None:
    lower, upper = ocp.model.thrust_limits
    prepared = Prepared(ocp, {"f_ext_W": [0.0, 0.0, 1e3]}, {})
    trim = prepared.over_horizon("thrust_trim")
    assert ((trim >= lower) & (trim <= upper)).all()
    assert (trim == lower).any()
