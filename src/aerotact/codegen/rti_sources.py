"""Transcription -> C of its real-time iteration: linearisation of all stages, quadratic programme, the two phases."""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from aerotact.codegen.backends import find_backend
from aerotact.codegen.functions import number
from aerotact.codegen.lanes import constant_entries, emit_stages
from aerotact.codegen.precision import files_in_single_precision
from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern
from aerotact.codegen.templating import templates
from aerotact.mpc.transcription import Transcription
from aerotact.ports import Array

FunctionRow = tuple[Any, str, list[str], list[str]]
"""A CasADi function, its name in C, the names of its arguments and of its results."""


@dataclass(frozen=True)
class RtiSources:
    """What a project takes in.

    Attributes:
        files: path inside the project -> text.
        functions: that `src/<name>_functions.c` must hold.
        context: what the templates know under `rti`.
    """

    files: dict[str, str]
    functions: list[FunctionRow]
    context: dict[str, Any]


def rti_sources(transcription: Transcription, backend: str, where: str, precision: str = "double") -> RtiSources:
    """C of the real-time iteration.

    Args:
        transcription: of the problem.
        backend: name of who solves the quadratic programme.
        where: file and key that named it, for the error.
        precision: of PRECISIONS.

    Raises:
        UnknownName: there is no such back end.
        CodegenError: an operation that C lacks.
    """
    s = transcription.statement
    name, n, m = s.name, s.ndx, s.nu
    solver = find_backend(backend, where)
    single = precision == "single"
    pattern = replace(stage_pattern(transcription), direct=True, single=single)
    places = solver.places(pattern)
    places |= {("C", i): [("qp_data.C", i)] for i in range(s.rows.size * n)}
    places |= {("g", i): [("g", i)] for i in range(s.rows.size)}
    results, last = transcription.linearise.name_out(), transcription.linearise_terminal.name_out()

    def wanted(result: str, entry: int) -> list[tuple[str, int]]:
        return [(f"rti->{array}[k]", index) for array, index in places.get((result, entry), [])]

    stages = emit_stages(
        transcription.linearise,
        f"{name}_linearise",
        f"{name}_rti *rti, const double *parameters, const double *lengths, const double *gains",
        f"{name.upper()}_STEPS",
        ["rti->x[k]", "rti->u[k]", "rti->x[k + 1]", "rti->stage[k]", "parameters", "lengths + k", f"gains + {m} * k"],
        lambda result, entry: wanted(results[result], entry),
    )
    fixed = zip(results, constant_entries(transcription.linearise), strict=True)
    bounds = s.bounds
    context = {
        "steps": transcription.steps,
        "usable": "1e-3" if single else "1e-4",
        "nx": s.nx,
        "ndx": n,
        "nu": m,
        "np": s.stage_size,
        "lengths": numbers(np.diff(s.times)),
        "gains": [numbers(row) for row in s.gains],
        "u_lower": numbers(bounds.u_lower),
        "u_upper": numbers(bounds.u_upper),
        "bounded": list(bounds.states),
        "x_lower": numbers(bounds.x_lower),
        "x_upper": numbers(bounds.x_upper),
        "lag": numbers(bounds.lag) if bounds.lag is not None else [],
        "rows": s.rows.size,
        "soft_rows": [i for i, soft in enumerate(s.rows.soft) if soft],
        "row_lower": numbers(s.rows.lower),
        "row_upper": numbers(s.rows.upper),
        "row_linear": numbers(np.where(s.rows.soft, s.rows.linear, 0.0)),
        "row_quadratic": numbers(s.rows.quadratic),
        "row_lengths": numbers(np.append(np.diff(s.times), s.rows.terminal)),
        "fixed": [
            (array, index, number(value))
            for result, entries in fixed
            for entry, value in entries.items()
            if value != 0.0
            for array, index in places.get((result, entry), [])
        ],
        "last": [
            (array, index, result, entry)
            for (result, entry), kept in places.items()
            if result in last
            for array, index in kept
        ],
    }
    known = {"name": name, "NAME": name.upper(), "rti": context}
    environment = templates()

    def render(template: str, **more: Any) -> str:
        return environment.get_template(template).render(known, **more)

    files = {
        f"include/{name}_rti.h": render("rti.h.jinja"),
        f"src/{name}_rti.c": render("rti.c.jinja"),
        f"src/{name}_lanes.h": render("lanes.h.jinja", lane_functions=stages.math, single=single),
        f"src/{name}_stages.h": render("stages.h.jinja", signature=stages.signature),
        f"src/{name}_stages.c": render("stages.c.jinja", source=stages.source),
        **solver.sources(name, pattern),
    }
    functions: list[FunctionRow] = [
        (transcription.linearise_terminal, f"{name}_linearise_terminal", ["x", "stage", "p"], last),
        (transcription.retract, f"{name}_retract", ["x", "dx"], ["moved"]),
        (transcription.difference, f"{name}_difference", ["from", "to"], ["dx"]),
        (transcription.rest, f"{name}_rest", ["x"], ["rest"]),
        (transcription.command, f"{name}_command", ["x", "u", "stage"], ["command"]),
    ]
    return RtiSources(files_in_single_precision(files) if single else files, functions, context)


def stage_pattern(transcription: Transcription) -> QpPattern:
    """Sparsity of the quadratic programme: what is the same constant in every stage is zero, one, or data."""
    s = transcription.statement
    constants = dict(zip(transcription.linearise.name_out(), constant_entries(transcription.linearise), strict=True))
    shapes = {"A": (s.ndx, s.ndx), "B": (s.ndx, s.nu), "Q": (s.ndx, s.ndx), "R": (s.nu, s.nu), "S": (s.nu, s.ndx)}
    grids = {}
    for name, (rows, columns) in shapes.items():
        grid = np.full(rows * columns, FREE)
        for entry, value in constants[name].items():
            grid[entry] = ZERO if value == 0.0 else ONE if value == 1.0 else FREE
        grids[name] = grid.reshape(rows, columns)
    # The last stage has a Hessian of its own.
    grids["Q"] = np.maximum(grids["Q"], np.ravel(_last_hessian(transcription)).reshape(s.ndx, s.ndx))
    # The changes have one coordinate fewer than the states, all of them before the plain ones that can be bounded.
    bounded = tuple(i - (s.nx - s.ndx) for i in s.bounds.states)
    return QpPattern(
        nx=s.ndx,
        nu=s.nu,
        steps=transcription.steps,
        bounded=bounded,
        general=s.rows.size,
        soft_rows=s.rows.soft,
        A=grids["A"].tolist(),
        B=grids["B"].tolist(),
        Q=grids["Q"].tolist(),
        R=grids["R"].tolist(),
        S=grids["S"].tolist(),
    )


def _last_hessian(transcription: Transcription) -> Array:
    """1 where the Hessian of the last stage is not the constant zero."""
    function = transcription.linearise_terminal
    symbols = [ca.SX.sym(f"i{n}", function.size1_in(n)) for n in range(function.n_in())]
    return ca.DM(ca.sparsify(function(*symbols)[0]).sparsity(), 1).full()


def numbers(values: Array) -> list[str]:
    """C literals of an array, flattened."""
    return [number(float(v)) for v in np.asarray(values, dtype=float).ravel()]
