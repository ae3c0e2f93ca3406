"""Offset-free: with the wrench of the environment given, the tool settles where it should, on the CasADi model."""

import casadi as ca
import numpy as np
import pytest
from inspection import Inspected

from aerotact.controller import Status
from aerotact.dynamics.model import Model
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

SUBSTEPS = 5
SECONDS = 14.0


def _plant(model: Model, period: float) -> ca.Function:
    """State a period later under a held command and a constant wrench; the rotors' lag is part of the derivative."""
    x, command = ca.SX.sym("x", model.state.size), ca.SX.sym("c", model.rotors)
    wrench = ca.SX.sym("w", model.disturbance.size)

    def f(state: ca.SX) -> ca.SX:
        return model.derivative(state, (command - state[13:]) / ca.DM(model.time_constants), wrench)

    h, after = period / SUBSTEPS, x
    for _ in range(SUBSTEPS):
        k1 = f(after)
        k2 = f(after + h / 2 * k1)
        k3 = f(after + h / 2 * k2)
        k4 = f(after + h * k3)
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("plant", [x, command, wrench], [after])


def _settle(ocp: Ocp, mpc: Inspected, f_ext_W: Array, tau_ext_B: Array, f_tool_W: Array) -> Array:
    """State after SECONDS of flight, starting at hover with the estimated wrench equal to the true one."""
    model = ocp.model
    plant, x = _plant(model, 1.0 / ocp.rate), model.hover_state
    given = {"f_ext_W": f_ext_W, "tau_ext_B": tau_ext_B, "f_tool_W": f_tool_W}
    for name, value in given.items():
        mpc.measurement[name][:] = value
    wrench = model.disturbance.pack({"f_ext_W": f_ext_W, "tau_ext_B": tau_ext_B})
    for _ in range(int(SECONDS * ocp.rate)):
        for name in ("p_WB", "q_WB", "v_WB", "w_B"):
            mpc.measurement[name][:] = model.state.unpack(x)[name]
        assert mpc.step() is Status.OK
        x = plant(x, mpc.output["thrust_cmd"], wrench).full().ravel()
        x[3:7] /= np.linalg.norm(x[3:7])
    np.testing.assert_allclose(x[13:], mpc.fields["limiter"], atol=1e-6)  # the modelled thrust is the true one
    return x


def test_wrench_on_the_robot_leaves_no_error_of_the_tool(ocp: Ocp, mpc: Inspected) -> None:
    """A wrench that the tool does not feel is only to be compensated."""
    x = _settle(ocp, mpc, np.array([1.0, -0.8, -1.5]), np.array([0.05, 0.08, -0.03]), np.zeros(3))
    p_WE, q_WE = (v.full().ravel() for v in ocp.model.tool_pose(ca.DM(x)))
    np.testing.assert_allclose(p_WE, mpc.reference["p_WE_d"][-1], atol=1e-6)
    assert abs(q_WE @ mpc.reference["q_WE_d"][-1]) == pytest.approx(1.0, abs=1e-10)


def test_force_on_the_tool_is_yielded_to_by_the_virtual_stiffness(ocp: Ocp, mpc: Inspected) -> None:
    force = np.array([1.0, 0.5, -0.6])
    lever = ocp.model.robot.p_BE - ocp.model.robot.p_BC
    x = _settle(ocp, mpc, force, np.cross(lever, force), force)
    norm = np.linalg.norm(force)
    felt = force * (norm - mpc.parameters["dead_zone_force"][0]) / norm
    expected = mpc.reference["p_WE_d"][-1] + felt / mpc.parameters["K_EP"]
    p_WE = ocp.model.tool_pose(ca.DM(x))[0].full().ravel()
    np.testing.assert_allclose(p_WE, expected, atol=2e-4)  # the slowest virtual mode decays with 0.9 rad/s
    np.testing.assert_allclose(p_WE, mpc.output["p_WE_r"], atol=2e-5)
