"""Ocp -> C project: the same interface as a law's, around a real-time iteration."""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from aerotact.codegen.backends import QpDimensions, find_backend
from aerotact.codegen.example import make_example
from aerotact.codegen.functions import number
from aerotact.codegen.lanes import StageFunction, Strided, emit_stages
from aerotact.codegen.project import CProject, assemble, block_context, limit_function, manifest, templates
from aerotact.mpc.ocp import WEIGHT, Ocp, limiter_of
from aerotact.ports import Array, Block, Layout, Port

NO_DEADLINE = 1.0  # s; counts only once the caller sets a clock


def mpc_block(ocp: Ocp) -> Block:
    """The controller as seen from outside: public ports, and the memory of its targets."""
    limiter = limiter_of(ocp)
    targets = ocp.targets
    hover = tuple(ocp.model.robot.hover_thrust)
    command = Port("thrust_cmd", ocp.model.rotors, "N", doc="thrust commands", default=hover)
    return replace(
        targets.block,
        measurement=ocp.measurement,
        parameters=ocp.parameters,
        output=Layout([command, *targets.telemetry]),
        limiter=limiter.step,
        limiter_state=limiter.state,
    )


def mpc_project(ocp: Ocp) -> CProject:
    """The C project of an MPC.

    Raises:
        UnknownName: the ocp file names no back end that exists.
    """
    name, model = ocp.name, ocp.model
    block = mpc_block(ocp)
    context = block_context(block, model.robot)
    context["mpc"] = _context(ocp)
    for port in next(g["ports"] for g in context["groups"] if g["title"] == "parameters"):
        if port["name"].startswith(WEIGHT):
            port["lower"] = number(0.0)
    functions = [
        (ocp.targets.block.step, f"{name}_prepare", ["z", "y", "r", "p"], ["z_next", "out"]),
        (ocp.linearise_terminal, f"{name}_linearise_terminal", ["x", "stage", "p"], ["Q", "q"]),
        (ocp.retract, f"{name}_retract", ["x", "dx"], ["moved"]),
        (ocp.command, f"{name}_command", ["x", "u"], ["command"]),
        (limit_function(block.limiter), f"{name}_limit", ["z", "wanted"], ["z_next", "u"]),
        (ocp.fallback.step, f"{name}_fallback", ["z", "y", "r", "p"], ["z_next", "u"]),
    ]
    backend = find_backend(ocp.file.solver.backend, f"{ocp.path}, solver.backend")
    dimensions = QpDimensions(
        model.tangent_size, model.control.size, ocp.steps, tuple(i - 1 for i in ocp.bounds.states)
    )
    stages = _stages(ocp)
    context["mpc"]["fixed"] = [
        (result, [(entry, number(value)) for entry, value in sorted(entries.items()) if value != 0.0])
        for result, entries in stages.constants.items()
    ]
    example = make_example(name, model, ocp.rate, block.measurement, block.reference, block.output, limited=True)
    inputs = hashlib.sha256(ocp.path.read_bytes()).hexdigest()
    extra = {
        "times_s": [float(t) for t in ocp.times],
        "ocp": {"file": ocp.path.name, "sha256": inputs, "backend": ocp.file.solver.backend, "steps": ocp.steps},
    }
    lanes = templates().get_template("lanes.h.jinja").render(NAME=name.upper(), lane_functions=stages.math)
    sources = {
        f"src/{name}_lanes.h": lanes,
        f"src/{name}_stages.c": templates().get_template("stages.c.jinja").render(name=name, source=stages.source),
        **backend(name, dimensions),
    }
    text = manifest(block, model.robot, extra)
    return assemble(context, functions, example, "mpc.c.jinja", text, sources, [stages.signature])


def _stages(ocp: Ocp) -> StageFunction:
    """The linearisation of all stages at once."""
    nx, ndx, nu = ocp.model.state.size, ocp.model.tangent_size, ocp.model.control.size
    inputs = [("x", nx), ("u", nu), ("x_next", nx), ("stage", ocp.targets.stage.size), ("p", 0), ("h", 1), ("gain", nu)]
    sizes = {"A": ndx * ndx, "B": ndx * nu, "b": ndx, "Q": ndx * ndx, "S": nu * ndx, "R": nu * nu, "q": ndx, "r": nu}
    return emit_stages(
        ocp.linearise,
        f"{ocp.name}_linearise",
        [Strided(name, stride) for name, stride in inputs],
        [Strided(name, stride) for name, stride in sizes.items()],
    )


def _numbers(values: Iterable[float] | Array) -> list[str]:
    return [number(float(v)) for v in np.asarray(values, dtype=float).ravel()]


def _map(target: Layout, source: Layout) -> list[tuple[int, int, int]]:
    """Rows (to, from, numbers) that fill `target` by name from `source`; of a preview, its first node."""
    return [(target.slice(p.name).start, source.slice(p.name).start, p.total) for p in target]


def _context(ocp: Ocp) -> dict[str, Any]:
    model, bounds, fallback = ocp.model, ocp.bounds, ocp.fallback
    block = ocp.targets.block
    groups = (("measurement", ocp.measurement), ("reference", block.reference), ("parameters", ocp.parameters))
    return {
        "steps": ocp.steps,
        "nx": model.state.size,
        "ndx": model.tangent_size,
        "nu": model.control.size,
        "np": ocp.targets.stage.size,
        "prepared_size": block.output.size,
        "lengths": _numbers(np.diff(ocp.times)),
        "gains": [_numbers(row) for row in ocp.gains],
        "u_lower": _numbers(bounds.u_lower),
        "u_upper": _numbers(bounds.u_upper),
        "bounded": list(bounds.states),
        "x_lower": _numbers(bounds.x_lower),
        "x_upper": _numbers(bounds.x_upper),
        "lag": _numbers(model.time_constants) if bounds.command else [],
        "max_failures": ocp.file.problem.max_failures,
        "iterations": ocp.file.solver.iterations,
        "startup_iterations": ocp.file.solver.startup_iterations,
        "deadline": number(NO_DEADLINE),
        "fallback_state_size": fallback.state.size,
        "fallback_state": _numbers(fallback.state.default),
        "fallback_sizes": {g: getattr(fallback, g).size for g in ("measurement", "reference", "parameters", "output")},
        "fallback_maps": [(g, _map(getattr(fallback, g), source)) for g, source in groups],
    }
