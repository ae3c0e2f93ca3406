"""A generated QP solver, compiled and called."""

import subprocess
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from problems import Problem

from aerotact.codegen.backends import aerotact_qp
from aerotact.codegen.build import find_compiler
from aerotact.codegen.qp_structure import QpPattern
from aerotact.ports import Array

WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")
NATIVE = ("-O2", "-march=native")


class Status(IntEnum):
    """As in the generated header."""

    OK, MAX_ITERATIONS, INFEASIBLE, NUMERICAL, DEADLINE = range(5)


@dataclass(frozen=True)
class Answer:
    """What a solve returned; `y` by stage: controls, bounded states, general rows."""

    status: Status
    x: Array
    u: Array
    pi: Array
    y: Array
    objective: float
    residuals: tuple[float, float, float]
    relaxed: bool
    iterations: int
    factorizations: int

    @property
    def finite(self) -> bool:
        return all(np.isfinite(a).all() for a in (self.x, self.u, self.pi, self.y)) and bool(
            np.isfinite(self.objective)
        )


class Solver:
    """The solver of one pattern; keeps its warm start until `forget`."""

    def __init__(self, folder: Path, pattern: QpPattern, flags: tuple[str, ...] = NATIVE) -> None:
        self.pattern = pattern
        source, library = write_solver(folder, pattern), folder / "libqp.so"
        command = [
            *find_compiler(),
            "-std=c99",
            *WARNINGS,
            f"-I{folder}/include",
            *flags,
            "-shared",
            "-fPIC",
            str(source),
            "-lm",
        ]
        subprocess.run([*command, "-o", str(library)], check=True)
        header = str(folder / "include" / "qp_qp.h")
        plain = subprocess.run([*find_compiler(), "-E", "-P", header], check=True, capture_output=True, text=True)
        self.ffi = cffi.FFI()
        self.ffi.cdef(plain.stdout)
        self._library: Any = self.ffi.dlopen(str(library))
        self.data, self.settings = self.ffi.new("qp_qp_data *"), self.ffi.new("qp_qp_settings *")
        self.solution = self.ffi.new("qp_qp_solution *")
        self._memory = np.zeros(self.ffi.sizeof("qp_qp_workspace") + 64, np.uint8)
        address = self._memory.ctypes.data
        self._workspace = self.ffi.cast("qp_qp_workspace *", address + (-address) % 64)
        self._library.qp_qp_default_settings(self.settings)
        self.forget()

    def forget(self) -> None:
        self._library.qp_qp_init(self._workspace)

    def shift(self) -> None:
        self._library.qp_qp_shift(self._workspace)

    def solve(self, problem: Problem, *, cold: bool = True) -> Answer:
        for name, values in problem.items():
            self._view(self.data, name)[:] = np.asarray(values, float).ravel()
        if cold:
            self.forget()
        status = Status(self._library.qp_qp_solve(self.data, self.settings, self._workspace, self.solution))
        p, s = self.pattern, self.solution
        assert status == s.status
        x, u, pi, y = (self._view(s, name).copy() for name in ("x", "u", "pi", "y"))
        return Answer(
            status,
            x.reshape(-1, p.nx),
            u.reshape(-1, p.nu),
            pi.reshape(-1, p.nx),
            y.reshape(p.steps + 1, -1),
            s.objective,
            (s.res_stationarity, s.res_feasibility, s.res_complementarity),
            bool(s.relaxed),
            s.iterations,
            s.factorizations,
        )

    def _view(self, structure: Any, name: str) -> Array:
        return np.frombuffer(self.ffi.buffer(getattr(structure, name)), float)


def write_solver(folder: Path, pattern: QpPattern) -> Path:
    """Write the generated files; returns the C file."""
    for path, text in aerotact_qp("qp", pattern).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    return folder / "src" / "qp_qp.c"
