"""Controller: a compiled C project, called from Python through its own C interface."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import cffi
import numpy as np
from numpy.typing import ArrayLike

from aerotact.codegen.build import compile_library
from aerotact.codegen.project import CProject
from aerotact.exceptions import CodegenError
from aerotact.ports import Array, Layout, Port


class Status(IntEnum):
    """What a step returned; MAX_ITERATIONS and DEADLINE are usable."""

    OK = 0
    MAX_ITERATIONS = 1
    INFEASIBLE = 2
    NUMERICAL = 3
    BAD_INPUT = 4
    DEADLINE = 5


@dataclass(frozen=True)
class Statistics:
    """What the last step did; residuals are recomputed by the solver from its data."""

    status: Status
    failures: int
    qp_iterations: int
    qp_stationarity: float
    qp_feasibility: float
    qp_complementarity: float


_ALIGNMENT = 64  # bytes
_CDEF = """
typedef struct {{ int status, failures, qp_iterations; {real} qp_stationarity, qp_feasibility, qp_complementarity; }}
    {n}_statistics;
size_t {n}_workspace_size(void);
void {n}_init(void *workspace);
void {n}_reset(void *workspace);
void {n}_default_parameters(void *parameters);
void {n}_default_reference(void *reference);
int {n}_step(void *workspace, const void *measurement, const void *reference, const void *parameters, void *output);
const {n}_statistics *{n}_statistics_of(const void *workspace);
"""


def _aligned(size: int) -> Array:
    """Zeros for a workspace of `size` bytes, aligned to the widest vector registers."""
    memory = np.zeros(-(-size // 8) + _ALIGNMENT // 8)
    start = -memory.ctypes.data % _ALIGNMENT // 8
    return memory[start : start + -(-size // 8)]


class Controller:
    """A law, an estimator or an MPC as it runs on the robot's computer.

    Inputs are written into `measurement`, `reference` and `parameters`: dicts of writable arrays, one a port, which are
    views of the C structs, of floats if the project is in single precision. `step` reads them and fills `output`, the
    same way.
    """

    def __init__(self, project: CProject) -> None:
        """Compile (or take from the cache) and load.

        Raises:
            CompilerNotFound, CodegenError: as compile_library; or the library cannot be loaded.
        """
        self.name = project.name
        self.manifest = project.manifest
        self.digest = project.digest
        self.rate = float(self.manifest["rate_hz"])
        self.library = compile_library(project)
        self._ffi = cffi.FFI()
        single = self.manifest.get("precision") == "single"
        self._ffi.cdef(_CDEF.format(n=self.name, real="float" if single else "double"))
        try:
            self._lib: Any = self._ffi.dlopen(str(self.library))
        except OSError as error:
            raise CodegenError(f"{self.library}: cannot be loaded: {error}; delete it and run again") from error
        self._buffers: dict[str, Array] = {}
        self._views: dict[str, dict[str, Array]] = {}
        for group, ports in self.manifest["ports"].items():
            layout = Layout(
                Port(p["name"], p["size"], p["unit"], p["frame"], kind=p["kind"], nodes=p["nodes"]) for p in ports
            )
            buffer = (layout.default if layout.size else np.zeros(1)).astype(np.float32 if single else float)
            self._buffers[group] = buffer
            self._views[group] = layout.unpack(buffer[: layout.size])
        size = int(self._call("workspace_size")())
        self._workspace = _aligned(size)
        self._init, self._reset, self._step = (self._call(n) for n in ("init", "reset", "step"))
        self._pointers = [
            self._pointer(b)
            for b in (
                self._workspace,
                *(self._buffers[g] for g in ("measurement", "reference", "parameters", "output")),
            )
        ]
        self._init(self._pointers[0])
        self._call("default_parameters")(self._pointers[3])
        self._call("default_reference")(self._pointers[2])
        self._statistics = self._call("statistics_of")

    def _call(self, function: str) -> Any:
        try:
            return getattr(self._lib, f"{self.name}_{function}")
        except AttributeError as error:
            raise CodegenError(f"{self.library}: {error}; delete it and run again") from error

    def _pointer(self, buffer: Array) -> Any:
        return self._ffi.cast("void *", buffer.ctypes.data)

    @property
    def measurement(self) -> dict[str, Array]:
        """Writable views of the measurement ports."""
        return self._views["measurement"]

    @property
    def reference(self) -> dict[str, Array]:
        """Writable views of the reference ports; previews have shape (nodes, size)."""
        return self._views["reference"]

    @property
    def parameters(self) -> dict[str, Array]:
        """Writable views of the parameters."""
        return self._views["parameters"]

    @property
    def output(self) -> dict[str, Array]:
        """Views of the outputs of the last step."""
        return self._views["output"]

    @property
    def workspace_bytes(self) -> int:
        """Size of the C workspace, bytes."""
        return int(self._call("workspace_size")())

    @property
    def statistics(self) -> Statistics:
        """What the last step did."""
        s = self._statistics(self._pointers[0])
        return Statistics(
            Status(s.status), s.failures, s.qp_iterations, s.qp_stationarity, s.qp_feasibility, s.qp_complementarity
        )

    def set_parameters(self, values: Mapping[str, ArrayLike]) -> None:
        """Set parameters by name; a scalar fills its port.

        Raises:
            UnknownName, InputError: a name or a size that does not fit.
        """
        ports = self.manifest["ports"]["parameters"]
        layout = Layout(Port(p["name"], p["size"], p["unit"], p["frame"]) for p in ports)
        flat = layout.unpack(layout.pack(values))
        for name in values:
            self.parameters[name][:] = flat[name]

    def flat(self, group: str) -> Array:
        """The whole struct of a group (measurement, reference, parameters, output) as one writable vector."""
        return self._buffers[group]

    def reset(self) -> None:
        """Forget the past."""
        self._reset(self._pointers[0])

    def step(self) -> Status:
        """One period."""
        return Status(self._step(*self._pointers))
