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
        retract: (x, dx) -> x; local: (x_from, x_to) -> dx; rest: x -> the same pose at rest, where a cold start begins.
        terms: (x, u, stage, parameters) -> residuals and their weights.
        terminal_terms: (x, stage, parameters) -> residuals and their weights, the latter times seconds.
        command: (x, u) -> what is sent to the robot.
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
    command: Callable[[Any, Any], Any]
    bounds: Bounds
    damping: float
    rows: Rows = NO_ROWS


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
        retract: (x, dx) -> x; difference: (x_from, x_to) -> dx; rest: x -> x; command: (x, u) -> command.
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

    def phi(state: Any, control: Any) -> Any:
        rate = control * gain / h
        k1 = s.derivative(state, rate, stage)
        k2 = s.derivative(state + h / 2 * k1, rate, stage)
        k3 = s.derivative(state + h / 2 * k2, rate, stage)
        k4 = s.derivative(state + h * k3, rate, stage)
        return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def at_zero(expression: Any) -> Any:
        return ca.substitute(expression, ca.vertcat(dx, du), ca.DM.zeros(s.ndx + s.nu))

    moved, changed = s.retract(x, dx), u + du
    gap = s.local(x_next, phi(moved, changed))
    A, B, b = at_zero(ca.jacobian(gap, dx)), at_zero(ca.jacobian(gap, du)), at_zero(gap)
    r, w = s.terms(moved, changed, stage, parameters)
    J = at_zero(ca.jacobian(r, ca.vertcat(dx, du)))
    weighted = h * ca.mtimes(J.T, ca.diag(w))
    H = ca.mtimes(weighted, J) + s.damping * h * ca.SX.eye(s.ndx + s.nu)
    g = ca.mtimes(weighted, at_zero(r))
    n = s.ndx
    r_end, w_end = s.terminal_terms(moved, stage, parameters)
    J_end = at_zero(ca.jacobian(r_end, dx))
    weighted_end = ca.mtimes(J_end.T, ca.diag(w_end))
    Q_end = ca.mtimes(weighted_end, J_end) + s.damping * ca.SX.eye(n)
    rows = []
    if s.rows.size:
        inequality = s.rows.build(moved, stage)
        rows = [at_zero(ca.jacobian(inequality, dx)), at_zero(inequality)]
    r_now, w_now = s.terms(x, u, stage, parameters)
    r_last, w_last = s.terminal_terms(x, stage, parameters)
    return Transcription(
        statement=s,
        linearise=_function(
            "linearise",
            [x, u, x_next, stage, parameters, h, gain],
            [A, B, b, H[:n, :n], H[n:, :n], H[n:, n:], g[:n], g[n:], *rows],
            ["A", "B", "b", "Q", "S", "R", "q", "r", *ROW_RESULTS[: len(rows)]],
        ),
        linearise_terminal=_function(
            "linearise_terminal",
            [x, stage, parameters],
            [Q_end, ca.mtimes(weighted_end, at_zero(r_end)), *rows],
            ["Q", "q", *ROW_RESULTS[: len(rows)]],
        ),
        step=ca.Function("step", [x, u, stage, h, gain], [phi(x, u)]),
        cost=ca.Function("cost", [x, u, stage, parameters, h], [h * ca.dot(w_now, r_now**2) / 2]),
        terminal_cost=ca.Function("terminal_cost", [x, stage, parameters], [ca.dot(w_last, r_last**2) / 2]),
        retract=ca.Function("retract", [x, dx], [s.retract(x, dx)]),
        difference=ca.Function("difference", [x, x_next], [s.local(x, x_next)]),
        rest=ca.Function("rest", [x], [s.rest(x)]),
        command=ca.Function("command", [x, u], [s.command(x, u)]),
    )


def _function(name: str, inputs: list[Any], outputs: list[Any], names: list[str]) -> Any:
    """Function with dense outputs, matrices row by row, common subexpressions shared."""
    rows = [ca.densify(ca.vec(o.T)) for o in outputs]
    return ca.Function(name, inputs, ca.cse(rows), [f"i{n}" for n in range(len(inputs))], names)


def held_gains(times: Array, first: Array) -> Array:
    """Gains (N, nu) of integrated controls: the intervals' lengths, but `first` (nu,) where the command is held."""
    gains = np.tile(np.diff(times)[:, None], (1, len(first)))
    gains[0] = first
    return gains
