"""Transcription: an optimal control problem as the CasADi functions that a real-time iteration needs.

    min  sum_k h_k sum_i w_i r_i(x_k, u_k, p_k)^2 / 2  +  terminal
    s.t. x_0 measured,  x_(k+1) = Phi_k(x_k, u_k, p_k),  bounds on x_k and u_k,  lower <= g(x_k, u_k, p_k) <= upper

by multiple shooting, one Runge-Kutta step of order four an interval, linearised on the manifold: the quadratic
programme is in the changes dx_k (three coordinates for an attitude) and du_k. The Hessian is Gauss-Newton's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.mpc.constraints import NO_ROWS, Bounds, Rows
from aerotact.mpc.jacobian import value_and_jacobian
from aerotact.ports import Array

ROW_RESULTS = ["C", "g"]


@dataclass(frozen=True)
class Statement:
    """What is to be transcribed, as symbolic expressions.

    Attributes:
        name: C prefix.
        nx, ndx, nu: numbers of a state, coordinates of its change, controls.
        stage_size, parameter_size: numbers of a stage's parameters, and of those that all stages share.
        times: nodes, s, shape (N + 1,).
        gains: change of an integrated control per unit in each interval, s, shape (N, nu): the interval's length, or
            less where a held command acts through a lag.
        derivative: (x, rate, stage) -> dx/dt, with rate = u * gain / h.
        within: x at the start of an interval -> derivative within it, where slow parts are held; None holds nothing.
        retract: (x, dx) -> x; local: (x_from, x_to) -> dx; rest: x -> the same pose at rest, where a cold start begins.
        terms: (x, u, stage, parameters) -> residuals and their weights.
        terminal_terms: (x, stage, parameters) -> residuals and their weights, the latter times seconds.
        command: (x, u, stage) -> what is sent to the robot.
        bounds: of states and controls.
        damping: Levenberg-Marquardt.
        rows: inequalities of the states, from the second node on.
    """

    name: str
    nx: int
    ndx: int
    nu: int
    stage_size: int
    parameter_size: int
    times: Array
    gains: Array
    derivative: Callable[[Any, Any, Any], Any]
    retract: Callable[[Any, Any], Any]
    local: Callable[[Any, Any], Any]
    rest: Callable[[Any], Any]
    terms: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    terminal_terms: Callable[[Any, Any, Any], tuple[Any, Any]]
    command: Callable[[Any, Any, Any], Any]
    bounds: Bounds
    damping: float
    rows: Rows = NO_ROWS
    within: Callable[[Any], Callable[[Any, Any, Any], Any]] | None = None


@dataclass(frozen=True)
class Transcription:
    """The functions.

    Attributes:
        statement: what was transcribed.
        linearise: (x, u, x_next, stage, parameters, h, gain) -> (A, B, b, Q, S, R, q, r), row by row, in changes; with
            inequality rows also (C, g), their Jacobian and value.
        linearise_terminal: (x, stage, parameters) -> (Q, q), and (C, g).
        step: (x, u, stage, h, gain) -> Phi.
        cost: (x, u, stage, parameters, h) -> cost of one stage; terminal_cost: (x, stage, parameters).
        retract: (x, dx) -> x; difference: (x_from, x_to) -> dx; rest: x -> x; command: (x, u, stage) -> command.
    """

    statement: Statement
    linearise: Any
    linearise_terminal: Any
    step: Any
    cost: Any
    terminal_cost: Any
    retract: Any
    difference: Any
    rest: Any
    command: Any

    @property
    def times(self) -> Array:
        """Nodes, s, shape (N + 1,)."""
        return self.statement.times

    @property
    def gains(self) -> Array:
        """Change of an integrated control per unit in each interval, s, shape (N, nu)."""
        return self.statement.gains

    @property
    def bounds(self) -> Bounds:
        """Bounds of states and controls."""
        return self.statement.bounds

    @property
    def steps(self) -> int:
        """Intervals N."""
        return len(self.statement.times) - 1


def transcribe(s: Statement) -> Transcription:
    """Build the functions, with dense outputs and shared subexpressions."""
    x, u, x_next = ca.SX.sym("x", s.nx), ca.SX.sym("u", s.nu), ca.SX.sym("x_next", s.nx)
    dx, du = ca.SX.sym("dx", s.ndx), ca.SX.sym("du", s.nu)
    stage, parameters = ca.SX.sym("stage", s.stage_size), ca.SX.sym("p", s.parameter_size)
    h, gain = ca.SX.sym("h"), ca.SX.sym("gain", s.nu)

    integrated = _integrated(s)

    def phi(state: Any, control: Any) -> Any:
        change = control * gain
        slope_of = s.within(state) if s.within else s.derivative

        def moved(share: float, slope: Any) -> Any:
            after = state + share * h * slope
            for row, column in integrated.items():
                after[row] = state[row] + share * change[column]
            return after

        k1 = slope_of(state, change / h, stage)
        k2 = slope_of(moved(0.5, k1), change / h, stage)
        k3 = slope_of(moved(0.5, k2), change / h, stage)
        k4 = slope_of(moved(1.0, k3), change / h, stage)
        return moved(1.0, (k1 + 2 * (k2 + k3) + k4) / 6)

    changes, n = ca.vertcat(dx, du), s.ndx
    x_moved, u_moved = s.retract(x, dx), u + du
    b, AB = value_and_jacobian(s.local(x_next, phi(x_moved, u_moved)), changes)
    H, g = _gauss_newton(*s.terms(x_moved, u_moved, stage, parameters), changes, h, s.damping)
    Q_end, q_end = _gauss_newton(*s.terminal_terms(x_moved, stage, parameters), dx, 1.0, s.damping)
    rows: tuple[Any, ...] = ()
    if s.rows.size:
        rows = value_and_jacobian(s.rows.build(x_moved, stage), dx)[::-1]
    r_now, w_now = s.terms(x, u, stage, parameters)
    r_last, w_last = s.terminal_terms(x, stage, parameters)
    return Transcription(
        statement=s,
        linearise=_function(
            "linearise",
            [x, u, x_next, stage, parameters, h, gain],
            [AB[:, :n], AB[:, n:], b, H[:n, :n], H[n:, :n], H[n:, n:], g[:n], g[n:], *rows],
            ["A", "B", "b", "Q", "S", "R", "q", "r", *ROW_RESULTS[: len(rows)]],
        ),
        linearise_terminal=_function(
            "linearise_terminal", [x, stage, parameters], [Q_end, q_end, *rows], ["Q", "q", *ROW_RESULTS[: len(rows)]]
        ),
        step=ca.Function("step", [x, u, stage, h, gain], [phi(x, u)]),
        cost=ca.Function("cost", [x, u, stage, parameters, h], [h * ca.dot(w_now, r_now**2) / 2]),
        terminal_cost=ca.Function("terminal_cost", [x, stage, parameters], [ca.dot(w_last, r_last**2) / 2]),
        retract=ca.Function("retract", [x, dx], [s.retract(x, dx)]),
        difference=ca.Function("difference", [x, x_next], [s.local(x, x_next)]),
        rest=ca.Function("rest", [x], [s.rest(x)]),
        command=ca.Function("command", [x, u, stage], [ca.densify(ca.cse(ca.SX(s.command(x, u, stage))))]),
    )


def _integrated(s: Statement) -> dict[int, int]:
    """State -> control, of the states whose rate is a control."""
    x, rate, stage = ca.SX.sym("x", s.nx), ca.SX.sym("rate", s.nu), ca.SX.sym("stage", s.stage_size)
    slope = s.derivative(x, rate, stage)
    return {i: j for i in range(s.nx) for j in range(s.nu) if ca.is_equal(slope[i], rate[j])}


def _gauss_newton(r: Any, w: Any, changes: Any, duration: Any, damping: float) -> tuple[Any, Any]:
    """Hessian, symmetric entry by entry, and gradient of duration * sum(w r^2) / 2 in the changes, at zero."""
    value, J = value_and_jacobian(r, changes)
    weighted = ca.mtimes(ca.diag(duration * w), J)
    H = ca.mtimes(weighted.T, J)
    return ca.triu2symm(ca.triu(H)) + damping * duration * ca.SX.eye(J.size2()), ca.mtimes(weighted.T, value)


def _function(name: str, inputs: list[Any], outputs: list[Any], names: list[str]) -> Any:
    """Function with dense outputs, matrices row by row, common subexpressions shared."""
    rows = [ca.densify(ca.vec(o.T)) for o in outputs]
    return ca.Function(name, inputs, ca.cse(rows), [f"i{n}" for n in range(len(inputs))], names)


def held_gains(times: Array, first: Array) -> Array:
    """Gains (N, nu) of integrated controls: the intervals' lengths, but `first` (nu,) where the command is held."""
    gains = np.tile(np.diff(times)[:, None], (1, len(first)))
    gains[0] = first
    return gains
