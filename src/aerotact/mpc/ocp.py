"""Ocp: a problem file transcribed for one model, as the CasADi functions that a real-time iteration needs.

    min  sum_k h_k sum_i w_i r_i(x_k, u_k, p_k)^2 / 2  +  terminal
    s.t. x_0 measured,  x_(k+1) = Phi_k(x_k, u_k, p_k),  bounds on x_k and u_k

by multiple shooting, one Runge-Kutta step of order four an interval, linearised on the manifold: the quadratic
programme is in the changes dx_k (three coordinates for the attitude) and du_k. The Hessian is Gauss-Newton's.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.actuators import held_command_gain, thrust_limiter
from aerotact.dynamics.model import Model
from aerotact.exceptions import InputError, ProblemError, UnknownName
from aerotact.laws import laws
from aerotact.mpc.constraints import CONSTRAINTS, Bounds, make_bounds
from aerotact.mpc.problem import ProblemFile, ResidualEntry, load_problem
from aerotact.mpc.residuals import RESIDUALS, Residual
from aerotact.mpc.targets import Targets, make_targets
from aerotact.ports import Array, Block, Layout, Port

WEIGHT = "weight_"  # names of the parameters that weigh residuals begin so; none may be negative


@dataclass(frozen=True)
class Ocp:
    """An optimal control problem of one model.

    Attributes:
        name: the file's stem.
        path: the ocp file.
        times: nodes, s, shape (N + 1,).
        targets: what is computed before a solve.
        fallback: the law that takes over when solves keep failing.
        bounds: of states and controls.
        gains: change of thrust per unit of the control in each interval, s, shape (N, nu): the first command is held,
            the later controls are rates of the actual thrust.
        linearise: (x, u, x_next, stage, parameters, h, gain) -> (A, B, b, Q, S, R, q, r), row by row, in changes.
        linearise_terminal: (x, stage, parameters) -> (Q, q).
        step: (x, u, stage, h, gain) -> Phi.
        cost: (x, u, stage, parameters, h) -> cost of one stage; terminal_cost: (x, stage, parameters).
        retract: (x, dx) -> x; command: (x, u) -> thrust command.
    """

    name: str
    path: Path
    file: ProblemFile
    model: Model
    times: Array
    targets: Targets
    fallback: Block
    bounds: Bounds
    gains: Array
    linearise: Any
    linearise_terminal: Any
    step: Any
    cost: Any
    terminal_cost: Any
    retract: Any
    command: Any

    @property
    def rate(self) -> float:
        """Hz at which the controller runs."""
        return self.file.problem.rate

    @property
    def steps(self) -> int:
        """Intervals N."""
        return len(self.times) - 1

    @property
    def parameters(self) -> Layout:
        """Parameters of the controller: weights, targets, and those of the fallback law that it does not share."""
        own = self.targets.block.parameters
        return Layout([*own, *(p for p in self.fallback.parameters if p.name not in own)])

    @property
    def measurement(self) -> Layout:
        """Measurement ports of the controller."""
        return Layout(self.targets.block.measurement.ports[:-1])


def _weights(path: Path, name: str, entry: ResidualEntry, residual: Residual, model: Model) -> list[Port]:
    """Parameter ports of a residual's weights; a term that the file does not name has weight zero."""
    key = f"residuals.{name}.weight"
    given = entry.weight if isinstance(entry.weight, dict) else {t.key: entry.weight for t in residual.terms}
    known = {t.key: t for t in residual.terms}
    for name_given in given:
        if name_given not in known:
            raise ProblemError(path, f"{key}.{name_given}", "is no term of this residual", f"valid: {', '.join(known)}")
    ports = []
    for term in residual.terms:
        size = term.size or model.rotors
        value = np.asarray(given.get(term.key, 0.0), dtype=float)
        if value.shape not in ((), (size,)):
            raise ProblemError(path, f"{key}.{term.key}", f"has {value.size} numbers", f"give one, or {size}")
        default = tuple(float(v) for v in np.broadcast_to(value, (size,)))
        label = name if name == term.key else f"{name}_{term.key}"
        ports.append(Port(f"{WEIGHT}{label}", size, term.unit, doc=f"weight of {residual.doc}", default=default))
    return ports


def load_ocp(name_or_path: str | Path, model: Model) -> Ocp:
    """Read an ocp file and transcribe it for a model.

    Raises:
        UnknownName: no such file.
        ProblemError: a key, residual, constraint, parameter or law that does not exist or does not fit.
        MissingCapability: the robot lacks what the problem, a residual or the fallback law needs.
    """
    path, file = load_problem(name_or_path)
    if not (path.stem.isascii() and path.stem.isidentifier()):
        raise ProblemError(path, "file", f"'{path.stem}' is no C identifier", "name it with letters, digits and _")
    for title, given, valid in (
        ("residuals", file.residuals, list(RESIDUALS)),
        ("constraints", file.constraints, list(CONSTRAINTS)),
        ("problem.fallback", [file.problem.fallback], list(laws())),
    ):
        for name in given:
            if name not in valid:
                raise ProblemError(path, title, f"unknown '{name}'", f"valid: {', '.join(sorted(valid))}")
    residuals = [RESIDUALS[name] for name in file.residuals]
    needs = [*file.problem.needs, *(n for r in residuals for n in r.needs)]
    unknown = sorted(set(needs) - {"six_axis_wrench", "tool"})
    if unknown:
        raise ProblemError(path, "problem.needs", f"unknown {unknown}", "valid: six_axis_wrench, tool")
    model.require(list(dict.fromkeys(needs)), f"problem '{path.stem}'")

    weights = [p for r in residuals for p in _weights(path, r.name, file.residuals[r.name], r, model)]
    uses = {r.target for r in residuals if r.target} | ({"thrust"} if "thrust" in file.residuals else set())
    times = file.problem.nodes
    targets = make_targets(path.stem, file.problem.doc, model, times, file.problem.rate, uses, weights)
    for parameter in file.parameters:
        if parameter.startswith(WEIGHT):
            raise ProblemError(path, f"parameters.{parameter}", "is a weight", "give it as the weight of its residual")
    try:
        block = targets.block.with_parameters(file.parameters)
    except (InputError, UnknownName) as error:
        raise ProblemError(path, "parameters", str(error), "one number, or one a coordinate") from error
    targets = Targets(block, targets.stage, targets.telemetry)
    fallback = laws()[file.problem.fallback](model, file.problem.rate)
    _check_fallback(path, fallback, targets.block)
    return _transcribe(path, file, model, np.array(times), targets, fallback, residuals)


def _check_fallback(path: Path, fallback: Block, block: Block) -> None:
    for group in ("measurement", "reference"):
        missing = [p.name for p in getattr(fallback, group) if p.name not in getattr(block, group)]
        if missing:
            raise ProblemError(
                path,
                "problem.fallback",
                f"'{fallback.name}' needs the {group} {', '.join(missing)}, which this problem has not",
                "choose a law with the same ports, or add the residual 'admittance'",
            )


def _transcribe(
    path: Path,
    file: ProblemFile,
    model: Model,
    times: Array,
    targets: Targets,
    fallback: Block,
    residuals: list[Residual],
) -> Ocp:
    nx, ndx, nu = model.state.size, model.tangent_size, model.control.size
    x, u, x_next = ca.SX.sym("x", nx), ca.SX.sym("u", nu), ca.SX.sym("x_next", nx)
    dx, du = ca.SX.sym("dx", ndx), ca.SX.sym("du", nu)
    stage, parameters = ca.SX.sym("stage", targets.stage.size), ca.SX.sym("p", targets.block.parameters.size)
    h, gain = ca.SX.sym("h"), ca.SX.sym("gain", nu)
    stage_parts = targets.stage.split(stage)
    weights = targets.block.parameters.split(parameters)
    disturbance = ca.vertcat(stage_parts["f_ext_W"], stage_parts["tau_ext_B"])

    def phi(state: Any, control: Any) -> Any:
        rate = control * gain / h
        k1 = model.derivative(state, rate, disturbance)
        k2 = model.derivative(state + h / 2 * k1, rate, disturbance)
        k3 = model.derivative(state + h / 2 * k2, rate, disturbance)
        k4 = model.derivative(state + h * k3, rate, disturbance)
        return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def terms(state: Any, control: Any, terminal: bool) -> tuple[Any, Any]:
        values, scales = [], []
        for residual in residuals:
            if terminal and residual.controls:
                continue
            built = residual.build(model, state, control, stage_parts)
            for term, value in zip(residual.terms, built, strict=True):
                label = residual.name if residual.name == term.key else f"{residual.name}_{term.key}"
                values.append(value)
                scales.append(weights[f"{WEIGHT}{label}"])
        return ca.vertcat(*values), ca.vertcat(*scales)

    def at_zero(expression: Any) -> Any:
        return ca.substitute(expression, ca.vertcat(dx, du), ca.DM.zeros(ndx + nu))

    damping = file.solver.levenberg_marquardt
    moved, changed = model.retract(x, dx), u + du
    gap = model.local(x_next, phi(moved, changed))
    A, B, b = at_zero(ca.jacobian(gap, dx)), at_zero(ca.jacobian(gap, du)), at_zero(gap)
    r, w = terms(moved, changed, terminal=False)
    J = at_zero(ca.jacobian(r, ca.vertcat(dx, du)))
    weighted = h * ca.mtimes(J.T, ca.diag(w))
    H = ca.mtimes(weighted, J) + damping * h * ca.SX.eye(ndx + nu)
    g = ca.mtimes(weighted, at_zero(r))
    outputs = [A, B, b, H[:ndx, :ndx], H[ndx:, :ndx], H[ndx:, ndx:], g[:ndx], g[ndx:]]
    names = ["A", "B", "b", "Q", "S", "R", "q", "r"]
    linearise = _function("linearise", [x, u, x_next, stage, parameters, h, gain], outputs, names)
    r_end, w_end = terms(moved, ca.SX.zeros(nu), terminal=True)
    J_end = at_zero(ca.jacobian(r_end, dx))
    weighted_end = file.problem.terminal * ca.mtimes(J_end.T, ca.diag(w_end))
    Q_end = ca.mtimes(weighted_end, J_end) + damping * ca.SX.eye(ndx)
    linearise_terminal = _function(
        "linearise_terminal", [x, stage, parameters], [Q_end, ca.mtimes(weighted_end, at_zero(r_end))], ["Q", "q"]
    )
    r_now, _ = terms(x, u, terminal=False)
    r_last, _ = terms(x, ca.SX.zeros(nu), terminal=True)
    cost = h * ca.dot(w, r_now**2) / 2
    cost_end = file.problem.terminal * ca.dot(w_end, r_last**2) / 2
    intervals = np.diff(times)
    gains = np.tile(intervals[:, None], (1, nu))
    gains[0] = held_command_gain(model, float(intervals[0])).full().ravel()
    return Ocp(
        name=path.stem,
        path=path,
        file=file,
        model=model,
        times=times,
        targets=targets,
        fallback=fallback,
        bounds=make_bounds(model, list(file.constraints)),
        gains=gains,
        linearise=linearise,
        linearise_terminal=linearise_terminal,
        step=ca.Function("step", [x, u, stage, h, gain], [phi(x, u)]),
        cost=ca.Function("cost", [x, u, stage, parameters, h], [cost]),
        terminal_cost=ca.Function("terminal_cost", [x, stage, parameters], [cost_end]),
        retract=ca.Function("retract", [x, dx], [model.retract(x, dx)]),
        command=ca.Function("command", [x, u], [model.command(x, u)]),
    )


def _function(name: str, inputs: list[Any], outputs: list[Any], names: list[str]) -> Any:
    """Function with dense outputs, matrices row by row, common subexpressions shared."""
    rows = [ca.densify(ca.vec(o.T)) for o in outputs]
    return ca.Function(name, inputs, ca.cse(rows), [f"i{n}" for n in range(len(inputs))], names)


def limiter_of(ocp: Ocp) -> Block:
    """The limiter that every command passes."""
    return thrust_limiter(ocp.model, ocp.rate)
