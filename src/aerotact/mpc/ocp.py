"""Ocp: an ocp file and a model, transcribed, with what surrounds the solve: targets and the fallback law."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.actuators import actuator_limiter, held_command_gain, reference_limiter
from aerotact.dynamics.model import CAPABILITIES, Model
from aerotact.dynamics.reduced import Reduced, predictor_of
from aerotact.exceptions import InputError, MissingCapability, ProblemError, UnknownName
from aerotact.laws import laws
from aerotact.mpc import prediction
from aerotact.mpc.arm_residuals import ARM_RESIDUALS
from aerotact.mpc.constraints import BOUNDS, CONSTRAINTS, ROWS, make_bounds, make_rows
from aerotact.mpc.problem import ProblemFile, ResidualEntry, load_problem
from aerotact.mpc.residuals import RESIDUALS as BODY_RESIDUALS
from aerotact.mpc.residuals import Residual
from aerotact.mpc.targets import Targets, make_targets
from aerotact.mpc.transcription import Statement, Transcription, held_gains, transcribe
from aerotact.ports import Array, Block, Layout, Port

RESIDUALS = BODY_RESIDUALS | ARM_RESIDUALS
WEIGHT = "weight_"  # names of the parameters that weigh residuals begin so; none may be negative


@dataclass(frozen=True)
class Ocp(Transcription):
    """An optimal control problem of one model.

    Attributes:
        path: the ocp file.
        file: its content.
        model: that predicts: of the robot, or reduced if it has arms.
        targets: what is computed before a solve.
        fallback: the law that takes over when solves keep failing.
    """

    path: Path
    file: ProblemFile
    model: Model
    targets: Targets
    fallback: Block

    @property
    def name(self) -> str:
        """The file's stem."""
        return self.statement.name

    @property
    def rate(self) -> float:
        """Hz at which the controller runs."""
        return self.file.problem.rate

    @property
    def measurement(self) -> Layout:
        """Measurement ports of the controller: those of the targets, then those that only the fallback law has."""
        return _joined(self._measured, self.fallback.measurement)

    @property
    def _measured(self) -> Layout:
        return Layout(self.targets.block.measurement.ports[: -len(self.model.actuators)])

    @property
    def reference(self) -> Layout:
        """Reference ports, in the same order."""
        return _joined(self.targets.block.reference, self.fallback.reference)

    @property
    def parameters(self) -> Layout:
        """Parameters, weights first, in the same order."""
        return _joined(self.targets.block.parameters, self.fallback.parameters)


def _joined(own: Layout, more: Layout) -> Layout:
    return Layout([*own, *(p for p in more if p.name not in own)])


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
        size = term.count(model)
        value = np.asarray(given.get(term.key, 0.0), dtype=float)
        if value.shape not in ((), (size,)):
            raise ProblemError(path, f"{key}.{term.key}", f"has {value.size} numbers", f"give one, or {size}")
        default = tuple(float(v) for v in np.broadcast_to(value, (size,)))
        label = name if name == term.key else f"{name}_{term.key}"
        ports.append(Port(f"{WEIGHT}{label}", size, term.unit, doc=f"weight of {residual.doc}", default=default))
    return ports


def load_ocp(name_or_path: str | Path, model: Model, delay: float | None = None) -> Ocp:
    """Read an ocp file and transcribe it for a model.

    Args:
        name_or_path: of the ocp file.
        model: of the robot.
        delay: s, instead of the file's own; rounded up to whole periods.

    Raises:
        UnknownName: no such file.
        ProblemError: a key, residual, constraint, parameter or law that does not exist or does not fit.
        MissingCapability: the robot lacks what the problem, a residual or the fallback law needs.
    """
    path, file = load_problem(name_or_path)
    if delay is not None:
        periods = math.ceil(delay * file.problem.rate - 1e-6)
        horizon = file.problem.model_copy(update={"delay": periods / file.problem.rate})
        file = file.model_copy(update={"problem": horizon})
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
    for name in file.constraints:
        if name in BOUNDS and file.constraints[name] != "hard":
            raise ProblemError(path, f"constraints.{name}", "is a limit of the actuators", 'it can only be "hard"')
    whole, model = model, predictor_of(model, file.problem.arms)
    residuals = [RESIDUALS[name] for name in file.residuals]
    needs = [
        *file.problem.needs,
        *(n for r in residuals for n in r.needs),
        *(n for name in file.constraints for n in CONSTRAINTS[name]),
        *("rigid_body" for r in residuals if r.name in BODY_RESIDUALS and r.uses != ("base",)),
    ]
    unknown = sorted(set(needs) - set(CAPABILITIES))
    if unknown:
        raise ProblemError(path, "problem.needs", f"unknown {unknown}", f"valid: {', '.join(sorted(CAPABILITIES))}")
    model.require(list(dict.fromkeys(needs)), f"problem '{path.stem}'")

    residuals = [r for r in residuals if all(term.count(model) for term in r.terms)]  # of joints that there are
    weights = [p for r in residuals for p in _weights(path, r.name, file.residuals[r.name], r, model)]
    uses = {kind for r in residuals for kind in r.uses}
    uses |= {kind for name in file.constraints if name in ROWS for kind in ROWS[name].uses}
    times = file.problem.nodes
    delay = file.problem.delay_periods
    targets = make_targets(path.stem, file.problem.doc, model, times, file.problem.rate, uses, weights, delay)
    for parameter in file.parameters:
        if parameter.startswith(WEIGHT):
            raise ProblemError(path, f"parameters.{parameter}", "is a weight", "give it as the weight of its residual")
    try:
        block = targets.block.with_parameters(file.parameters)
    except (InputError, UnknownName) as error:
        raise ProblemError(path, "parameters", str(error), "one number, or one a coordinate") from error
    targets = Targets(block, targets.stage, targets.telemetry)
    try:
        fallback = laws()[file.problem.fallback](whole, file.problem.rate)
    except MissingCapability as error:
        raise MissingCapability(f"problem '{path.stem}', fallback: {error}") from error
    _check_fallback(path, fallback, targets.block, model)
    transcription = transcribe(_state(path, file, model, targets, residuals))
    own = {f.name: getattr(transcription, f.name) for f in fields(Transcription)}
    return Ocp(**own, path=path, file=file, model=model, targets=targets, fallback=fallback)


def _check_fallback(path: Path, fallback: Block, block: Block, model: Model) -> None:
    first = model.commands.ports[0].name
    if first not in fallback.output:
        raise ProblemError(
            path, "problem.fallback", f"'{fallback.name}' gives no {first}", f"choose a law that gives {first}"
        )
    for group in ("measurement", "reference", "parameters"):
        theirs, ours = getattr(fallback, group), getattr(block, group)
        for port in theirs:
            if port.name in ours and (port.size, port.unit) != (ours[port.name].size, ours[port.name].unit):
                raise ProblemError(
                    path,
                    "problem.fallback",
                    f"'{fallback.name}' has another {group} {port.name}, of {port.size} numbers in {port.unit}",
                    "choose a law with the same ports",
                )


def _state(path: Path, file: ProblemFile, model: Model, targets: Targets, residuals: list[Residual]) -> Statement:
    """The problem in symbols."""
    times = np.array(file.problem.nodes)

    first = float(times[1])

    def motion(x: Any, rate: Any, stage: Any) -> Any:
        return prediction.derivative(model, x, rate, targets.stage.split(stage))

    def within(start: Any) -> Callable[[Any, Any, Any], Any]:
        arms = model.arms_at(start) if isinstance(model, Reduced) else None
        return lambda x, rate, stage: prediction.derivative(model, x, rate, targets.stage.split(stage), arms)

    def command(x: Any, u: Any, stage: Any) -> Any:
        if not isinstance(model, Reduced):
            return model.command(x, u)
        p = targets.stage.split(stage)
        sent = model.command(x, u, prediction.parameter(p), first / 2)
        return ca.vertcat(sent[: -model.full.servos], sent[-model.full.servos :] + p["servo_shift"])

    def terms(x: Any, u: Any, stage: Any, parameters: Any) -> tuple[Any, Any]:
        return _terms(model, targets, residuals, x, u, stage, parameters)

    def terminal_terms(x: Any, stage: Any, parameters: Any) -> tuple[Any, Any]:
        lasting = [r for r in residuals if not r.controls]
        values, weights = _terms(model, targets, lasting, x, ca.SX.zeros(model.control.size), stage, parameters)
        return values, file.problem.terminal * weights

    return Statement(
        name=path.stem,
        nx=model.state.size,
        ndx=model.tangent_size,
        nu=model.control.size,
        stage_size=targets.stage.size,
        parameter_size=targets.block.parameters.size,
        times=times,
        gains=held_gains(times, _held(model, first)),
        derivative=motion,
        within=within,
        retract=model.retract,
        local=model.local,
        rest=model.at_rest,
        terms=terms,
        terminal_terms=terminal_terms,
        command=command,
        bounds=make_bounds(model, list(file.constraints)),
        damping=file.solver.levenberg_marquardt,
        rows=make_rows(path, model, file.constraints, targets.stage, file.problem.terminal),
    )


def _terms(
    model: Model, targets: Targets, residuals: list[Residual], x: Any, u: Any, stage: Any, parameters: Any
) -> tuple[Any, Any]:
    """Residuals and weights, one below the other."""
    shared = targets.block.parameters.split(parameters)
    known = {**shared, **targets.stage.split(stage)}
    values, scales = [], []
    for residual in residuals:
        built = residual.build(model, x, u, known)
        for term, value in zip(residual.terms, built, strict=True):
            label = residual.name if residual.name == term.key else f"{residual.name}_{term.key}"
            values.append(value)
            scales.append(shared[f"{WEIGHT}{label}"])
    return ca.vertcat(*values), ca.vertcat(*scales)


def _held(model: Model, period: float) -> Array:
    if isinstance(model, Reduced):
        return model.held_gain(period)
    return np.ravel(held_command_gain(model, period).full())


def limiter_of(ocp: Ocp) -> Block:
    """The limiter that every command passes."""
    return (
        reference_limiter(ocp.model, ocp.rate)
        if isinstance(ocp.model, Reduced)
        else actuator_limiter(ocp.model, ocp.rate)
    )
