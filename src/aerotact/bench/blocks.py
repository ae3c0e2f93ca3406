"""Blocks: time of one step of every law and estimator, compiled as for the robot's computer."""

from contextlib import suppress
from dataclasses import replace
from typing import Any

import cffi
import numpy as np

from aerotact.bench.peers.aerotact_peer import aligned
from aerotact.codegen.build import compile_library
from aerotact.codegen.footprint import code_and_data
from aerotact.codegen.project import block_project
from aerotact.codegen.templating import templates
from aerotact.dynamics.model import Model
from aerotact.estimation import estimators
from aerotact.exceptions import MissingCapability
from aerotact.laws import laws
from aerotact.ports import Block

STEPS, BATCHES, RATE = 200, 25, 500.0


def time_blocks(model: Model) -> dict[str, dict[str, Any]]:
    """Block that fits -> microseconds a step (median and largest mean of batches), bytes of workspace and code."""
    blocks = []
    for build in {**laws(), **estimators()}.values():
        with suppress(MissingCapability):
            blocks.append(build(model, RATE))
    return {block.name: _time(block, model) for block in blocks}


def _time(block: Block, model: Model) -> dict[str, Any]:
    project, name = block_project(block, model), block.name
    source = f"src/{name}_timed.c"
    text = templates().get_template("timed_block.c.jinja").render(name=name, NAME=name.upper())
    library = compile_library(
        replace(project, files={**project.files, source: text}, sources=(*project.sources, source))
    )
    ffi = cffi.FFI()
    ffi.cdef(
        f"double {name}_timed_steps(void *workspace, const void *measurement, int count); "
        f"size_t {name}_workspace_size(void);"
    )
    lib: Any = ffi.dlopen(str(library))
    size = int(getattr(lib, f"{name}_workspace_size")())
    workspace, measured = aligned(size), block.measurement.default
    run = getattr(lib, f"{name}_timed_steps")
    pointers = [ffi.cast("void *", a.ctypes.data) for a in (workspace, measured)]
    times = 1e6 * np.array([run(*pointers, STEPS) for _ in range(BATCHES)])
    return {
        "p50_us": float(np.median(times)),
        "max_us": float(times.max()),
        "usable": bool((times > 0).all()),
        "bytes": {"workspace": size, "code": (code_and_data(library) or (0, 0))[0]},
    }
