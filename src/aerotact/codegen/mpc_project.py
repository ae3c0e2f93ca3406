"""Ocp -> C project: the same interface as a law's, around a real-time iteration."""

import hashlib
from dataclasses import replace
from typing import Any

from aerotact.codegen.backends import BACKENDS
from aerotact.codegen.example import make_example
from aerotact.codegen.functions import number
from aerotact.codegen.linked import linked_context
from aerotact.codegen.project import CProject, assemble, block_context, in_single_precision, limit_function, manifest
from aerotact.codegen.rti_sources import FunctionRow, numbers, rti_sources
from aerotact.mpc.ocp import Ocp, limiter_of
from aerotact.ports import Block, Layout

NO_DEADLINE = 1.0  # s; counts only once the caller sets a clock


def mpc_block(ocp: Ocp) -> Block:
    """The controller as seen from outside: public ports, and the memory of its targets."""
    limiter = limiter_of(ocp)
    targets = ocp.targets
    return replace(
        targets.block,
        measurement=ocp.measurement,
        reference=ocp.reference,
        parameters=ocp.parameters,
        output=Layout([*ocp.model.commands, *targets.telemetry]),
        limiter=limiter.step,
        limiter_state=limiter.state,
    )


def mpc_project(ocp: Ocp, precision: str | None = None) -> CProject:
    """The C project of an MPC.

    Args:
        ocp: the problem.
        precision: "double" or "single", instead of the file's own.

    Raises:
        UnknownName: the ocp file names no back end that exists.
        CodegenError: the back end lacks what the file wants.
    """
    name, model = ocp.name, ocp.model
    block = mpc_block(ocp)
    context = block_context(block, model.robot)
    context["mpc"] = _context(ocp)
    precision = precision or ocp.file.solver.precision
    rti = rti_sources(ocp, ocp.file.solver.backend, f"{ocp.path}, solver.backend", precision)
    context["rti"] = rti.context
    backend = BACKENDS[ocp.file.solver.backend]
    context["caveat"], context["linked"] = backend.caveat, linked_context(backend.linked)
    functions: list[FunctionRow] = [
        (ocp.targets.block.step, f"{name}_prepare", ["z", "y", "r", "p"], ["z_next", "out"]),
        *rti.functions,
        (limit_function(block.limiter), f"{name}_limit", ["z", "wanted"], ["z_next", "u"]),
        (ocp.fallback.step, f"{name}_fallback", ["z", "y", "r", "p"], ["z_next", "u"]),
    ]
    example = make_example(name, model, ocp.rate, block.measurement, block.reference, block.output, limited=True)
    inputs = hashlib.sha256(ocp.path.read_bytes()).hexdigest()
    extra = {
        "precision": precision,
        "times_s": [float(t) + ocp.file.problem.delay for t in ocp.times],
        "ocp": {"file": ocp.path.name, "sha256": inputs, "backend": ocp.file.solver.backend, "steps": ocp.steps},
        **({"caveat": context["caveat"]} if context["caveat"] else {}),
    }
    text = manifest(block, model.robot, extra)
    context["precision"] = precision
    project = assemble(context, functions, example, "mpc.c.jinja", text, rti.files)
    return in_single_precision(project) if precision == "single" else project


def _map(target: Layout, source: Layout) -> list[tuple[int, int, int]]:
    """Rows (to, from, numbers) that fill `target` by name from `source`; of a preview, its first node."""
    return [(target.slice(p.name).start, source.slice(p.name).start, p.total) for p in target]


def _context(ocp: Ocp) -> dict[str, Any]:
    fallback, block, commands = ocp.fallback, ocp.targets.block, ocp.model.commands
    groups = (("measurement", ocp.measurement), ("reference", ocp.reference), ("parameters", ocp.parameters))
    return {
        "targets_measurement": block.measurement.size - ocp.model.actuators.size,
        "prepared_size": block.output.size,
        "max_failures": ocp.file.problem.max_failures,
        "iterations": ocp.file.solver.iterations,
        "startup_iterations": ocp.file.solver.startup_iterations,
        "shift": ocp.file.solver.shift,
        "deadline": number(NO_DEADLINE),
        "fallback_state_size": fallback.state.size,
        "fallback_state": numbers(fallback.state.default),
        "fallback_sizes": {g: getattr(fallback, g).size for g in ("measurement", "reference", "parameters", "output")},
        "fallback_commands": [
            (commands.slice(p.name).start, fallback.output.slice(p.name).start, p.total)
            for p in commands
            if p.name in fallback.output
        ],
        "fallback_maps": [(g, _map(getattr(fallback, g), source)) for g, source in groups],
    }
