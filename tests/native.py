"""Generated C, called function by function: what src/<name>_functions.h declares, and a C harness around a project."""

import re
import subprocess
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from aerotact.codegen.build import compile_library, find_compiler
from aerotact.codegen.linked import compile_flags, find_library, link_flags
from aerotact.codegen.project import CProject
from aerotact.ports import Array

PLAIN = ("-O2",)
# One lane: checked vectors take a minute to compile, and test_lanes.py shows that they give the same.
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-DAEROTACT_LANES=1")


class Native:
    """The functions of a project's shared library."""

    def __init__(self, project: CProject) -> None:
        header = project.files[f"src/{project.name}_functions.h"]
        self.declared = re.findall(r"^void (\w+)\(.*\);$", header, flags=re.MULTILINE)
        self.ffi = cffi.FFI()
        self.ffi.cdef("\n".join(re.findall(r"^void .*;$", header, flags=re.MULTILINE)))
        self.library: Any = self.ffi.dlopen(str(compile_library(project)))

    def __call__(self, name: str, function: Any, inputs: list[Array]) -> list[Array]:
        """The C function `name`, with as many outputs as the CasADi `function` has; each flat, column by column.

        Outputs start as NaN, so that an entry which is not written shows.
        """
        held = [np.ascontiguousarray(value, dtype=float).ravel() for value in inputs]
        results = [np.full(max(function.numel_out(i), 1), np.nan) for i in range(function.n_out())]
        getattr(self.library, name)(*(self.ffi.cast("double *", v.ctypes.data) for v in (*held, *results)))
        return [r[: function.numel_out(i)] for i, r in enumerate(results)]


def evaluate(function: Any, inputs: list[Array]) -> list[Array]:
    """CasADi's own evaluation, each output flat, column by column."""
    results = function.call([np.asarray(v, dtype=float) for v in inputs])
    return [r.full().ravel(order="F") for r in results]


def run(folder: Path, project: CProject, source: str, flags: tuple[str, ...] = PLAIN) -> str:
    """Compile a C program with the project's sources, run it and give back what it prints.

    Raises:
        AssertionError: it does not compile or does not return 0.
    """
    project.write(folder / project.name)
    (folder / "harness.c").write_text(source)
    program = folder / "harness"
    sources = [str(folder / project.name / s) for s in project.sources]
    includes = [f"-I{folder / project.name / part}" for part in ("include", "src")]
    sources += _third_party(folder, project, flags)
    linked = [find_library(name) for name in project.linked]
    includes += compile_flags(linked)
    command = [*find_compiler(), "-std=c99", *flags, "-Wall", "-Wextra", *includes, str(folder / "harness.c"), *sources]
    built = subprocess.run(
        [*command, *link_flags(linked), "-lm", "-o", str(program)], capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr[:4000]
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"returned {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def _third_party(folder: Path, project: CProject, flags: tuple[str, ...]) -> list[str]:
    """Objects of what others wrote, compiled without warnings."""
    objects = []
    for source in project.third_party:
        objects.append(str(folder / Path(source).with_suffix(".o").name))
        command = [*find_compiler(), "-std=c99", *flags, "-w", "-c", str(folder / project.name / source)]
        subprocess.run([*command, "-o", objects[-1]], check=True)
    return objects
