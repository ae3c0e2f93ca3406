"""Transcription: derivatives on the manifold, curvature, and the linearisation's gap, in random states."""

from typing import Any

import casadi as ca
import numpy as np
import pytest

from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

STEP, TOLERANCE = 1e-6, 1e-5


class Point:
    """A random place of linearisation."""

    def __init__(self, ocp: Ocp, seed: int) -> None:
        rng = np.random.default_rng(seed)
        model = ocp.model
        self.x, self.x_next = (self._state(ocp, rng) for _ in range(2))
        self.u = rng.uniform(-60.0, 60.0, model.control.size)
        self.stage = ocp.targets.stage.default + rng.uniform(-0.5, 0.5, ocp.targets.stage.size)
        for port in ocp.targets.stage:
            if port.kind == "quaternion":
                where = ocp.targets.stage.slice(port.name)
                self.stage[where] /= np.linalg.norm(self.stage[where])
        layout = ocp.targets.block.parameters
        self.parameters = layout.default * rng.uniform(0.5, 2.0, layout.size)
        self.parameters[layout.slice("weight_rate")] *= 1e4  # so that differences of the cost show it
        self.h = float(rng.uniform(0.01, 0.12))
        self.gain = rng.uniform(0.3, 1.0, model.control.size) * self.h

    @staticmethod
    def _state(ocp: Ocp, rng: np.random.Generator) -> Array:
        x = ocp.model.hover_state + rng.uniform(-1.0, 1.0, ocp.model.state.size)
        x[3:7] = rng.normal(size=4)
        x[3:7] /= np.linalg.norm(x[3:7])
        return x

    def linearised(self, ocp: Ocp) -> dict[str, Array]:
        """Matrices by name; they come row by row."""
        ndx, nu = ocp.model.tangent_size, ocp.model.control.size
        shapes = [(ndx, ndx), (ndx, nu), (ndx,), (ndx, ndx), (nu, ndx), (nu, nu), (ndx,), (nu,)]
        values = ocp.linearise(self.x, self.u, self.x_next, self.stage, self.parameters, self.h, self.gain)
        names = ("A", "B", "b", "Q", "S", "R", "q", "r")
        return {n: v.full().reshape(s) for n, v, s in zip(names, values, shapes, strict=True)}


def _difference(function: Any, size: int) -> Array:
    """Jacobian at zero by central differences."""
    columns = []
    for direction in STEP * np.eye(size):
        columns.append((np.atleast_1d(function(direction)) - np.atleast_1d(function(-direction))) / (2 * STEP))
    return np.array(columns).T


def _local(ocp: Ocp) -> Any:
    a, b = ca.SX.sym("a", ocp.model.state.size), ca.SX.sym("b", ocp.model.state.size)
    return ca.Function("local", [a, b], [ocp.model.local(a, b)])


@pytest.mark.parametrize("seed", range(3))
def test_dynamics_derivatives_equal_finite_differences_on_the_manifold(ocp: Ocp, seed: int) -> None:
    at = Point(ocp, seed)
    # the gap is small in a solve; the chart's derivative is exact anywhere
    at.x_next = ocp.step(at.x, at.u, at.stage, at.h, at.gain).full().ravel() + 0.05 * np.ones(ocp.model.state.size)
    at.x_next[3:7] /= np.linalg.norm(at.x_next[3:7])
    local = _local(ocp)

    def gap(dx: Array, du: Array) -> Array:
        moved = ocp.retract(at.x, dx)
        return local(at.x_next, ocp.step(moved, at.u + du, at.stage, at.h, at.gain)).full().ravel()

    ndx, nu = ocp.model.tangent_size, ocp.model.control.size
    got = at.linearised(ocp)
    assert np.abs(got["B"]).max() > 1e-3
    np.testing.assert_allclose(got["A"], _difference(lambda d: gap(d, np.zeros(nu)), ndx), atol=TOLERANCE)
    np.testing.assert_allclose(got["B"], _difference(lambda d: gap(np.zeros(ndx), d), nu), atol=TOLERANCE)
    np.testing.assert_allclose(got["b"], gap(np.zeros(ndx), np.zeros(nu)), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_gradients_equal_finite_differences_of_the_cost(ocp: Ocp, seed: int) -> None:
    at = Point(ocp, seed)
    ndx, nu = ocp.model.tangent_size, ocp.model.control.size

    def cost(dx: Array, du: Array) -> Array:
        return ocp.cost(ocp.retract(at.x, dx), at.u + du, at.stage, at.parameters, at.h).full().ravel()

    def end(dx: Array) -> Array:
        return ocp.terminal_cost(ocp.retract(at.x, dx), at.stage, at.parameters).full().ravel()

    got = at.linearised(ocp)
    for gradient, numeric in (
        (got["q"], _difference(lambda d: cost(d, np.zeros(nu)), ndx)),
        (got["r"], _difference(lambda d: cost(np.zeros(ndx), d), nu)),
        (ocp.linearise_terminal(at.x, at.stage, at.parameters)[1].full(), _difference(end, ndx)),
    ):
        scale = np.abs(numeric).max()
        assert scale > 1e-6
        np.testing.assert_allclose(gradient.ravel(), numeric.ravel(), atol=TOLERANCE * scale)


@pytest.mark.parametrize("seed", range(3))
def test_hessian_is_symmetric_and_positive_semidefinite(ocp: Ocp, seed: int) -> None:
    at = Point(ocp, seed)
    got = at.linearised(ocp)
    H = np.block([[got["Q"], got["S"].T], [got["S"], got["R"]]])
    end = ocp.linearise_terminal(at.x, at.stage, at.parameters)[0].full().reshape(got["Q"].shape)
    for matrix in (H, end):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
        eigenvalues = np.linalg.eigvalsh(matrix)
        assert eigenvalues.max() > 1.0
        assert eigenvalues.min() > -1e-12 * eigenvalues.max()


def test_hessian_is_the_second_derivative_where_residuals_are_linear(ocp: Ocp) -> None:
    at = Point(ocp, 5)
    nu = ocp.model.control.size
    R = at.linearised(ocp)["R"]
    weight = ocp.targets.block.parameters.unpack(at.parameters)["weight_rate"]
    expected = at.h * np.diag(weight + ocp.file.solver.levenberg_marquardt)
    np.testing.assert_allclose(R, expected, rtol=1e-12)
    assert R.shape == (nu, nu)


def test_first_control_is_a_held_command_and_the_others_are_rates(ocp: Ocp) -> None:
    tau, period = ocp.model.time_constants, 1.0 / ocp.rate
    np.testing.assert_allclose(ocp.gains[0], tau * (1 - np.exp(-period / tau)), rtol=1e-14)
    np.testing.assert_allclose(ocp.gains[1:], np.diff(ocp.times)[1:, None] * np.ones((1, ocp.model.rotors)), rtol=1e-14)
    x, u = ocp.model.hover_state, np.full(ocp.model.rotors, 20.0)
    stage = ocp.targets.stage.default
    after = ocp.step(x, u, stage, period, ocp.gains[0]).full().ravel()
    command = ocp.command(x, u, stage).full().ravel()
    held = x[13:] + (command - x[13:]) * (1 - np.exp(-period / tau))
    np.testing.assert_allclose(after[13:], held, rtol=1e-13)
