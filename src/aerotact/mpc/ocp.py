"""Ocp: an ocp file and a model, transcribed, with what surrounds the solve: targets and the fallback law."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.actuators import actuator_limiter, held_command_gain
from aerotact.dynamics.model import CAPABILITIES, Model
from aerotact.exceptions import InputError, MissingCapability, ProblemError, UnknownName
from aerotact.laws import laws
from aerotact.mpc.constraints import CONSTRAINTS, NEEDS, make_bounds
from aerotact.mpc.problem import ProblemFile, ResidualEntry, load_problem
from aerotact.mpc.residuals import RESIDUALS, Residual
from aerotact.mpc.targets import Targets, make_targets
from aerotact.mpc.transcription import Statement, Transcription, held_gains, transcribe
from aerotact.ports import Block, Layout, Port

WEIGHT = "weight_"  # names of the parameters that weigh residuals begin so; none may be negative


@dataclass(frozen=True)
class Ocp(Transcription):
    """An optimal control problem of one model.

    Attributes:
        path: the ocp file.
        file: its content.
        model: of the robot.
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
    def parameters(self) -> Layout:
        """Parameters of the controller: weights, targets, and those of the fallback law that it does not share."""
        own = self.targets.block.parameters
        return Layout([*own, *(p for p in self.fallback.parameters if p.name not in own)])

    @property
    def measurement(self) -> Layout:
        """Measurement ports of the controller."""
        return Layout(self.targets.block.measurement.ports[: -len(self.model.actuators)])


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
    needs = [
        *file.problem.needs,
        *(n for r in residuals for n in r.needs),
        *(NEEDS[name] for name in file.constraints if name in NEEDS),
    ]
    unknown = sorted(set(needs) - set(CAPABILITIES))
    if unknown:
        raise ProblemError(path, "problem.needs", f"unknown {unknown}", f"valid: {', '.join(sorted(CAPABILITIES))}")
    model.require(list(dict.fromkeys(needs)), f"problem '{path.stem}'")

    weights = [p for r in residuals for p in _weights(path, r.name, file.residuals[r.name], r, model)]
    uses = {r.target for r in residuals if r.target} | {"trim" for r in residuals if r.trim}
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
    try:
        fallback = laws()[file.problem.fallback](model, file.problem.rate)
    except MissingCapability as error:
        raise MissingCapability(f"problem '{path.stem}', fallback: {error}") from error
    _check_fallback(path, fallback, targets.block)
    transcription = transcribe(_state(path, file, model, targets, residuals))
    own = {f.name: getattr(transcription, f.name) for f in fields(Transcription)}
    return Ocp(**own, path=path, file=file, model=model, targets=targets, fallback=fallback)


def _check_fallback(path: Path, fallback: Block, block: Block) -> None:
    if fallback.limiter is None:
        raise ProblemError(
            path, "problem.fallback", f"'{fallback.name}' commands no thrust", "choose a law whose output is thrust_cmd"
        )
    for group in ("measurement", "reference"):
        missing = [p.name for p in getattr(fallback, group) if p.name not in getattr(block, group)]
        if missing:
            raise ProblemError(
                path,
                "problem.fallback",
                f"'{fallback.name}' needs the {group} {', '.join(missing)}, which this problem has not",
                "choose a law with the same ports, or add the residual 'admittance'",
            )


def _state(path: Path, file: ProblemFile, model: Model, targets: Targets, residuals: list[Residual]) -> Statement:
    """The problem in symbols."""
    times = np.array(file.problem.nodes)

    def derivative(x: Any, rate: Any, stage: Any) -> Any:
        parts = targets.stage.split(stage)
        return model.derivative(x, rate, ca.vertcat(parts["f_ext_W"], parts["tau_ext_B"]))

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
        gains=held_gains(times, held_command_gain(model, float(times[1])).full().ravel()),
        derivative=derivative,
        retract=model.retract,
        local=model.local,
        rest=model.at_rest,
        terms=terms,
        terminal_terms=terminal_terms,
        command=model.command,
        bounds=make_bounds(model, list(file.constraints)),
        damping=file.solver.levenberg_marquardt,
    )


def _terms(
    model: Model, targets: Targets, residuals: list[Residual], x: Any, u: Any, stage: Any, parameters: Any
) -> tuple[Any, Any]:
    """Residuals and weights, one below the other."""
    stage_parts = targets.stage.split(stage)
    weights = targets.block.parameters.split(parameters)
    values, scales = [], []
    for residual in residuals:
        built = residual.build(model, x, u, stage_parts)
        for term, value in zip(residual.terms, built, strict=True):
            label = residual.name if residual.name == term.key else f"{residual.name}_{term.key}"
            values.append(value)
            scales.append(weights[f"{WEIGHT}{label}"])
    return ca.vertcat(*values), ca.vertcat(*scales)


def limiter_of(ocp: Ocp) -> Block:
    """The limiter that every command passes."""
    return actuator_limiter(ocp.model, ocp.rate)
