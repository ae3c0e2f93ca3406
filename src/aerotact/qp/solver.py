"""QpSolver: the C of a back end, compiled for one size and called from Python."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import cffi
import numpy as np
from numpy.typing import ArrayLike

from aerotact.codegen.backends import find_backend
from aerotact.codegen.build import compile_library
from aerotact.codegen.project import THIRD_PARTY, CProject
from aerotact.codegen.qp_structure import QpPattern
from aerotact.exceptions import CodegenError, InputError, UnknownName
from aerotact.ports import Array


class QpStatus(IntEnum):
    """What a solve returned; MAX_ITERATIONS and DEADLINE are to be judged by their residuals."""

    OK = 0
    MAX_ITERATIONS = 1
    INFEASIBLE = 2
    NUMERICAL = 3
    DEADLINE = 4


@dataclass(frozen=True)
class QpResult:
    """Solution of an OCP QP.

    Attributes:
        status: of the solver.
        x, u: states (N + 1, nx) and controls (N, nu).
        pi: multipliers of the dynamics (N, nx).
        y: multipliers of the rows (N + 1, nu + bounded states + general rows): > 0 at the upper side, < 0 at the lower.
        stationarity, feasibility, complementarity: residuals, recomputed from the data, unscaled, largest entry.
        iterations: of the solver, all its phases.
    """

    status: QpStatus
    x: Array
    u: Array
    pi: Array
    y: Array
    stationarity: float
    feasibility: float
    complementarity: float
    iterations: int


class QpSolver:
    """A solver of OCP QPs of one size.

        min  sum_(k<N) 1/2 [x_k; u_k]' [Q_k S_k'; S_k R_k] [x_k; u_k] + q_k'x_k + r_k'u_k  +  1/2 x_N'Q_N x_N + q_N'x_N
        s.t. x_0 given,  x_(k+1) = A_k x_k + B_k u_k + b_k,  lbu <= u <= ubu,  lbx <= x[bounded] <= ubx,
             lg <= C x + D u <= ug

    `data` and `settings` are views of the C structs, by the names of the generated header.
    """

    def __init__(self, pattern: QpPattern, backend: str = "aerotact", name: str = "qp") -> None:
        """Generate, compile (or take from the cache) and load.

        Raises:
            UnknownName: there is no such back end.
            CompilerNotFound, CodegenError: as compile_library; or the back end cannot do this.
        """
        self.pattern = pattern
        chosen = find_backend(backend, "QpSolver")
        files = dict(chosen.sources(name, pattern))
        header = f"{name}_qp.h"
        size = f"size_t {name}_qp_workspace_bytes(void)"
        shim = f"src/{name}_qp_workspace_bytes.c"
        files[shim] = (
            f'#include <stddef.h>\n#include "{header}"\n\n{size};\n{size} {{ return sizeof({name}_qp_workspace); }}\n'
        )
        sources = tuple(p for p in files if p.endswith(".c") and not p.startswith(THIRD_PARTY))
        self._ffi = cffi.FFI()
        self._ffi.cdef(_declarations(files[f"include/{header}"], name) + f"\n{size};")
        library = compile_library(CProject(name, files, sources, chosen.linked))
        try:
            self._lib: Any = self._ffi.dlopen(str(library))
        except OSError as error:
            raise CodegenError(f"{library}: cannot be loaded: {error}; delete it and run again") from error
        self._init, self._solve = (getattr(self._lib, f"{name}_qp_{f}") for f in ("init", "solve"))
        self._data = self._ffi.new(f"{name}_qp_data *")
        self._settings = self._ffi.new(f"{name}_qp_settings *")
        self._solution = self._ffi.new(f"{name}_qp_solution *")
        self._memory = np.zeros(getattr(self._lib, f"{name}_qp_workspace_bytes")() // 8 + 16)
        start = self._memory.ctypes.data
        self._workspace = self._ffi.cast("void *", start + -start % 64)
        getattr(self._lib, f"{name}_qp_default_settings")(self._settings)
        self._real = np.float32 if pattern.single else np.float64
        self.data = self._views(self._data)
        self._found = self._views(self._solution)
        self.reset()

    @property
    def settings(self) -> Any:
        """The C struct of settings; its fields can be read and set."""
        return self._settings

    def reset(self) -> None:
        """Forget the last solution, and all data."""
        self._init(self._workspace)
        for value in self.data.values():
            value[:] = 0.0

    def write(self, data: Mapping[str, ArrayLike]) -> None:
        """Copy into the fields that `data` names; the others keep what they had.

        Raises:
            UnknownName, InputError: a field or a size that does not fit.
        """
        for field, value in data.items():
            if field not in self.data:
                raise UnknownName("field", field, self.data, "QpSolver.write")
            array = np.asarray(value, dtype=float)
            if array.size != self.data[field].size:
                raise InputError(f"{field}: {array.size} numbers; valid: {self.data[field].size}")
            self.data[field][:] = array.reshape(self.data[field].shape)

    def solve(self, data: Mapping[str, ArrayLike] | None = None) -> QpResult:
        """Solve, warm-started, after writing `data`.

        Raises:
            UnknownName, InputError: as write.
        """
        self.write(data or {})
        status = self._solve(self._data, self._settings, self._workspace, self._solution)
        s, found = self._solution, self._found
        return QpResult(
            status=QpStatus(status),
            x=found["x"].copy(),
            u=found["u"].copy(),
            pi=found["pi"].copy(),
            y=found["y"].copy(),
            stationarity=s.res_stationarity,
            feasibility=s.res_feasibility,
            complementarity=s.res_complementarity,
            iterations=s.iterations + s.active_set_iterations,
        )

    def _views(self, struct: Any) -> dict[str, Array]:
        """Arrays of numbers in a C struct, as writable arrays (stages, numbers of a stage)."""
        views = {}
        for name, field in self._ffi.typeof(struct).item.fields:
            if field.type.kind == "array":
                shape, item = [field.type.length], field.type.item
                while item.kind == "array":
                    shape.append(item.length)
                    item = item.item
                memory = self._ffi.buffer(self._ffi.addressof(struct[0], name))
                views[name] = np.frombuffer(memory, dtype=self._real).reshape(shape)
        return views


def _declarations(header: str, name: str) -> str:
    """What Python calls and touches, from a generated header; the workspace stays closed."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    macros = dict(re.findall(r"^#define (\w+) (\S.*)$", text, flags=re.MULTILINE))
    known = re.compile(rf"\b({'|'.join(macros)})\b")
    while known.search(body := re.sub(r"^#.*$", "", text, flags=re.MULTILINE)):
        text = known.sub(lambda match: macros[match[1]], body)
    qp = f"{name}_qp"
    found = re.findall(rf"typedef (?:enum|struct) \{{[^{{}}]*\}} {qp}_(?:status|data|settings|solution);", text)
    functions = [
        f"void {qp}_default_settings({qp}_settings *settings);",
        f"void {qp}_init(void *workspace);",
        f"{qp}_status {qp}_solve(const {qp}_data *, const {qp}_settings *, void *, {qp}_solution *);",
    ]
    return "\n".join([*found, *functions])
