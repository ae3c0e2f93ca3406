"""A compiled MPC whose private workspace can be read: trajectory, plan, stage parameters, quadratic programme."""

from typing import Any

import cffi
import numpy as np

from aerotact.codegen.backends import aerotact_places
from aerotact.codegen.lanes import constant_entries
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.codegen.rti_sources import stage_pattern
from aerotact.controller import Controller
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array


class Inspected(Controller):
    """A controller with views of its workspace."""

    def __init__(self, ocp: Ocp) -> None:
        project = mpc_project(ocp)
        name, N = project.name, ocp.steps
        nx, ndx, nu = ocp.model.state.size, ocp.model.tangent_size, ocp.model.control.size
        bounded = len(ocp.bounds.states)
        shapes = {
            **{"x": (N + 1, nx), "u": (N, nu), "plan_x": (N + 1, nx), "plan_u": (N, nu)},
            **{
                "stage": (N + 1, ocp.targets.stage.size),
                "limiter": (ocp.model.actuators.size,),
                "state": (ocp.targets.block.state.size,),
            },
            **{"fallback_state": (ocp.fallback.state.size,)},
            **{"qp_data.lbu": (N, nu), "qp_data.ubu": (N, nu)},
            **({"qp_data.lbx": (N + 1, bounded), "qp_data.ubx": (N + 1, bounded)} if bounded else {}),
            **{f"qp_workspace.{a}": (N, -1) for a in ("G", "gain", "c")},
            **{f"qp_workspace.{a}": (N + 1, -1) for a in ("hv", "q")},
            **{"qp_solution.x": (N + 1, ndx), "qp_solution.u": (N, nu)},
        }
        of_rti = ("x", "u", "stage")  # the iteration's own; the rest is the controller's
        places = [f"rti.{f}" if f in of_rti or f.startswith("qp_") else f for f in shapes]
        cases = "\n".join(
            f"    case {i}: *size = sizeof(w->{place}); return (double *)(void *)w->{place};"
            for i, place in enumerate(places)
        )
        source = (
            f'#include "{name}.h"\n'
            f"double *{name}_field(void *workspace, int field, size_t *size);\n"
            f"void {name}_configure(void *workspace, int max_failures, int startup_iterations, int iterations,\n"
            f"    double deadline);\n"
            f"double *{name}_field(void *workspace, int field, size_t *size)\n"
            f"{{\n    {name}_workspace *w = workspace;\n"
            f"    switch (field) {{\n{cases}\n    }}\n    return NULL;\n}}\n"
            "static double now;\n\nstatic double clock_of_calls(void *context)\n{\n"
            "    *(double *)context += 1.0;\n    return *(double *)context;\n}\n"
            f"void {name}_configure(void *workspace, int max_failures, int startup_iterations, int iterations,\n"
            f"    double deadline)\n{{\n"
            f"    {name}_workspace *w = workspace;\n    w->settings.max_failures = max_failures;\n"
            f"    w->settings.startup_iterations = startup_iterations;\n    w->settings.iterations = iterations;\n"
            f"    w->settings.clock = deadline > 0.0 ? clock_of_calls : NULL;\n    w->settings.clock_context = &now;\n"
            f"    w->settings.deadline = deadline;\n}}\n"
        )
        source += f"int {name}_broken;\n"
        extra, rti = f"src/{name}_inspection.c", f"src/{name}_rti.c"
        solve = f"{name}_qp_feedback("
        breakable = f"{name}_broken ? {name.upper()}_QP_NUMERICAL : {solve}"
        assert project.files[rti].count(solve) == 1
        injected = f"extern int {name}_broken;\n" + project.files[rti].replace(solve, breakable)
        super().__init__(CProject(name, {**project.files, extra: source, rti: injected}, (*project.sources, extra)))
        ffi = cffi.FFI()
        ffi.cdef(
            f"double *{name}_field(void *, int, size_t *); extern int {name}_broken;"
            f"void {name}_configure(void *, int, int, int, double);"
        )
        library: Any = ffi.dlopen(str(self.library))
        workspace = ffi.cast("void *", self._workspace.ctypes.data)
        self._inspection, self._broken = library, f"{name}_broken"
        self.break_solver(False)  # the library may be loaded already
        self._configure = lambda *settings: getattr(library, f"{name}_configure")(workspace, *settings)
        self.fields: dict[str, Array] = {}
        size = ffi.new("size_t *")
        for i, (field, shape) in enumerate(shapes.items()):
            address = getattr(library, f"{name}_field")(workspace, i, size)
            values = np.frombuffer(ffi.buffer(address, size[0]))
            own = values[:0] if 0 in shape else values  # an array of nothing has one number in C
            self.fields[field.removeprefix("qp_data.")] = own.reshape(shape)
        self._ocp = ocp

    @property
    def programme(self) -> dict[str, Array]:
        """Matrices and vectors of every stage, as the solver holds them and what it knows to be constant."""
        s, N = self._ocp.statement, self._ocp.steps
        n, m = s.ndx, s.nu
        shapes = {"A": (n, n), "B": (n, m), "b": (n,), "Q": (n, n), "S": (m, n), "R": (m, m), "q": (n,), "r": (m,)}
        found = {name: np.zeros((N + (name in ("Q", "q")), int(np.prod(shape)))) for name, shape in shapes.items()}
        for name, constants in zip(shapes, constant_entries(self._ocp.linearise), strict=True):
            for entry, value in constants.items():
                found[name][:N, entry] = value
        for (name, entry), places in aerotact_places(stage_pattern(self._ocp)).items():
            array, index = places[0]
            found[name][:, entry] = self.fields[array][: len(found[name]), index]
        matrices = {name: found[name].reshape(-1, *shape) for name, shape in shapes.items()}
        for name in ("Q", "R"):  # the solver keeps one triangle, whichever
            there = matrices[name]
            matrices[name] = np.where(there == 0.0, np.swapaxes(there, 1, 2), there)
        return matrices

    def configure(
        self, *, max_failures: int = 5, startup_iterations: int = 5, iterations: int = 1, deadline: float = 0.0
    ) -> None:
        """Change the settings of the workspace; with a `deadline`, a clock that advances by one with every call."""
        self._configure(max_failures, startup_iterations, iterations, deadline)

    def break_solver(self, broken: bool) -> None:
        """Let every quadratic programme end as NUMERICAL, or no longer."""
        setattr(self._inspection, self._broken, int(broken))

    def hover(self, ocp: Ocp) -> None:
        """Measurements of the robot at rest in its hover keyframe."""
        for name, value in ocp.model.state.unpack(ocp.model.hover_state).items():
            if name in self.measurement and self.measurement[name].shape == value.shape:
                self.measurement[name][:] = value
