"""The generated solver: its C library, timed inside C by the monotonic clock."""

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from aerotact import __version__
from aerotact.bench.peers.peer import Absent, Answer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Solution
from aerotact.bench.scenario import Sample
from aerotact.codegen.build import FLAGS, compile_library, find_compiler
from aerotact.codegen.footprint import code_and_data
from aerotact.codegen.linked import find_library
from aerotact.codegen.project import CProject
from aerotact.codegen.rti_project import rti_project
from aerotact.codegen.templating import templates
from aerotact.exceptions import LibraryNotFound
from aerotact.ports import Array

_CDEF = """
typedef {real} real;
typedef struct {{
    double prepare, feedback, stationarity, feasibility, complementarity;
    int iterations, factorizations, status;
}} timed;
size_t {n}_timed_size(void);
void {n}_timed_init(void *rti);
void {n}_timed_run(void *rti, const real *x, const real *u, const real *stages, const real *parameters,
    const real *measured, real tolerance, real *dx, real *du, real *y, timed *result);
"""
_USABLE = (0, 1)  # OK, MAX_ITERATIONS
_SCALAR = {"double": "double", "single": "float"}


class AerotactPeer:
    """One row of the table for one back end: our linearisation, and whoever solves the quadratic programme."""

    every = 1

    def __init__(
        self,
        problem: Problem,
        backend: str = "aerotact",
        fresh: bool = False,
        tolerance: float = 0.0,
        precision: str = "double",
    ) -> None:
        """Generate, compile (even if the cache has it, if `fresh`), load.

        Args:
            problem: what it solves.
            backend: who solves the quadratic programme.
            fresh: compile even if the cache has it.
            tolerance: of the quadratic programme; the back end's own if 0.
            precision: "double", or "single" for floats.

        Raises:
            UnknownName: no such back end.
            Absent: the back end links what is not here.
            CodegenError: it does not compile.
        """
        t, self._s = problem.transcription, problem.transcription.statement
        begin = time.perf_counter()
        project = timed_project(problem, backend, precision)
        self._scratch = tempfile.TemporaryDirectory(prefix="aerotact-") if fresh else None
        try:
            self._library = compile_library(project, cache=Path(self._scratch.name) if self._scratch else None)
        except LibraryNotFound as error:
            raise Absent(f"{backend}: skipped, {error}") from error
        self.build_seconds = time.perf_counter() - begin
        self._tolerance = tolerance
        words = [backend, f"{tolerance:.0e}".replace("e-0", "e-") if tolerance else ""]
        self.name = " ".join(w for w in (*words, "single" if precision == "single" else "") if w)
        self.settings = f"{' '.join([*find_compiler(), *FLAGS[:3]])}, back end {backend}, {precision} precision"
        self.versions = {"aerotact": __version__, **{name: find_library(name).version for name in project.linked}}
        self._ffi = cffi.FFI()
        self._ffi.cdef(_CDEF.format(n=project.name, real=_SCALAR[precision]))
        self._lib: Any = self._ffi.dlopen(str(self._library))
        self._init, self._run = (getattr(self._lib, f"{project.name}_timed_{f}") for f in ("init", "run"))
        size = int(getattr(self._lib, f"{project.name}_timed_size")())
        self.sizes = {"workspace": size, "code": (code_and_data(self._library) or (0, 0))[0]}
        N, n, m, rows = t.steps, self._s.ndx, self._s.nu, len(self._s.bounds.states)
        self._rti = aligned(size)
        self._real = np.float32 if precision == "single" else np.float64
        shapes = ((N + 1, n), (N, m), (N + 1, m + rows))
        self._dx, self._du, self._y = (np.zeros(shape, dtype=self._real) for shape in shapes)
        self._parameters = np.append(problem.parameters, 0.0)
        self._result = self._ffi.new("timed *")
        self.reset()

    def _pointer(self, values: Array) -> Any:
        return self._ffi.cast("real *", values.ctypes.data)

    def reset(self) -> None:
        """Empty workspace."""
        self._init(self._ffi.cast("void *", self._rti.ctypes.data))

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        """One iteration; the copies into and out of the workspace are not timed, as with every peer."""
        given = (sample.x, sample.u, sample.stages, self._parameters, sample.measured)
        held = [np.ascontiguousarray(v, dtype=self._real) for v in given]
        results = [self._dx, self._du, self._y]
        workspace = self._ffi.cast("void *", self._rti.ctypes.data)
        self._run(workspace, *map(self._pointer, held), self._tolerance, *map(self._pointer, results), self._result)
        prepare, feedback = 1e6 * self._result.prepare, 1e6 * self._result.feedback
        m = self._s.nu
        y = np.concatenate([self._y[:-1, :m].ravel(), self._y[1:, m:].ravel()])
        return Answer(
            u0=sample.u[0] + self._du[0],
            prepare=prepare,
            feedback=feedback,
            total=prepare + feedback,
            usable=self._result.status in _USABLE,
            work=self._result.factorizations,
            solution=Solution(self._dx.astype(float), self._du.astype(float), y.astype(float)) if full else None,
        )


def timed_project(problem: Problem, backend: str = "aerotact", precision: str = "double") -> CProject:
    """The bare solver and the function that times it, by a clock in doubles."""
    project = rti_project(problem.transcription, backend, problem.doc, precision)
    name = project.name
    rti = {"np": problem.transcription.statement.stage_size}
    context = {"name": name, "NAME": name.upper(), "rti": rti, "real": _SCALAR[precision]}
    source = f"src/{name}_timed.c"
    text = templates().get_template("timed_rti.c.jinja").render(context)
    return replace(project, files={**project.files, source: text}, sources=(*project.sources, source))


def aligned(size: int) -> Array:
    """`size` zero bytes that begin at a multiple of 64, as a static variable of C would for vector code."""
    raw = np.zeros(size + 64, dtype=np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size]
