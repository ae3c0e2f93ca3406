"""acados, found through ACADOS_SOURCE_DIR: SQP-RTI with HPIPM, at the settings that make it fast.

What these are: the discrete dynamics as a CasADi expression with shared subexpressions instead of an integrator,
Gauss-Newton least squares, partial condensing, tolerance 1e-6, external functions compiled with -O3 -march=native.
Two forms of the problem: "tangent" has the attitude in three coordinates about the trajectory, which makes its
quadratic programme the common one; "quaternion" has the state as it is, four numbers for the attitude, which has
fewer operations to evaluate and one more coordinate to solve for. Times are acados' own; setting values is not timed.
"""

import contextlib
import ctypes
import importlib
import importlib.metadata
import io
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np

from aerotact.bench.peers.peer import Absent, Answer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Qp, Solution, first_bounds
from aerotact.bench.scenario import Sample
from aerotact.ports import Array

Form = Literal["quaternion", "tangent"]
FLAGS = "-O3 -march=native"
FORMS: tuple[Form, ...] = ("quaternion", "tangent")
TOLERANCE = 1e-6
ITERATIONS = 50


@dataclass(frozen=True)
class Setting:
    """Form of the problem; intervals left after partial condensing; mode of HPIPM."""

    form: Form
    condensed: int
    mode: Literal["SPEED", "BALANCE"]

    @property
    def label(self) -> str:
        """Short name."""
        return f"{self.form}/{self.condensed}" + ("" if self.mode == "SPEED" else f"/{self.mode}")

    def __str__(self) -> str:
        return f"{self.form}, {self.condensed} blocks, {self.mode}"


def settings(steps: int) -> list[Setting]:
    """What is tried: no condensing, half and a quarter of the intervals; the mode does not depend on the form."""
    blocks = list(dict.fromkeys([steps, max(steps // 2, 1), max(steps // 4, 1)]))
    fast = [Setting(form, b, "SPEED") for form in FORMS for b in blocks]
    return [*fast, Setting("quaternion", blocks[min(1, len(blocks) - 1)], "BALANCE")]


def acados_template() -> Any:
    """The module acados_template.

    Raises:
        Absent: acados is not there.
    """
    root = os.environ.get("ACADOS_SOURCE_DIR")
    if not root:
        raise Absent("acados: skipped, ACADOS_SOURCE_DIR is not set")
    if not (Path(root) / "lib").is_dir():
        raise Absent(f"acados: skipped, {root}/lib is missing: ACADOS_SOURCE_DIR must be an acados that is built")
    for folder in (Path(root) / "interfaces" / "acados_template", Path(root) / "interfaces", Path(root).parent):
        if (folder / "acados_template" / "__init__.py").is_file() and str(folder) not in sys.path:
            sys.path.append(str(folder))
    for library in ("blasfeo", "hpipm", "qpOASES_e"):  # found here, so that no library path has to be set
        for file in sorted((Path(root) / "lib").glob(f"lib{library}.*")):
            with contextlib.suppress(OSError):
                ctypes.CDLL(str(file), mode=ctypes.RTLD_GLOBAL)
    try:
        return importlib.import_module("acados_template")
    except ImportError as error:
        raise Absent(f"acados: skipped, its Python interface cannot be imported: {error}") from error


class AcadosPeer:
    """acados at one setting."""

    every = 1

    def __init__(self, problem: Problem, setting: Setting) -> None:
        """Generate, compile, load.

        Raises:
            Absent: acados is not there or does not build.
        """
        module = acados_template()
        self._problem, self._t = problem, problem.transcription
        self._tangent = setting.form == "tangent"
        self.form, self.setting = setting.form, setting
        self.name = f"acados {setting.label}"
        self.settings = (
            f"SQP_RTI, DISCRETE dynamics with ca.cse, NONLINEAR_LS, GAUSS_NEWTON, PARTIAL_CONDENSING_HPIPM, {setting}, "
            f"tolerance {TOLERANCE:g}, external functions {FLAGS}"
        )
        self.versions = {"acados": _version()}
        self.sizes: dict[str, int] = {}
        begin = time.perf_counter()
        self._scratch = tempfile.TemporaryDirectory(prefix="aerotact-acados-")
        try:
            with _quiet():
                ocp = self._ocp(module)
                self._solver = module.AcadosOcpSolver(ocp, json_file=str(Path(self._scratch.name) / "ocp.json"))
        except (Exception, SystemExit) as error:  # acados raises bare Exceptions
            raise Absent(f"acados ({setting}): skipped, it does not build: {error}") from error
        self.build_seconds = time.perf_counter() - begin

    def _ocp(self, module: Any) -> Any:
        t, s = self._t, self._t.statement
        N, shift = t.steps, s.nx - s.ndx
        uniform = np.ptp(np.diff(t.times)) < 1e-12 and np.ptp(t.gains) < 1e-12
        size = s.ndx if self._tangent else s.nx
        v, u = ca.SX.sym("x", size), ca.SX.sym("u", s.nu)
        stage = ca.SX.sym("stage", s.stage_size)
        extra = [] if uniform else [ca.SX.sym("h"), ca.SX.sym("gain", s.nu)]
        h, gain = extra if extra else (ca.DM(t.times[1]), ca.DM(t.gains[0]))
        here, following = ca.SX.sym("here", s.nx), ca.SX.sym("following", s.nx)
        x = s.retract(here, v) if self._tangent else v
        landed = t.step(x, u, stage, h, gain)
        after = s.local(following, landed) if self._tangent else landed
        common = ca.DM(self._problem.parameters)
        values, weights = s.terms(x, u, stage, common)
        last_values, last_weights = s.terminal_terms(x, stage, common)

        model = module.AcadosModel()
        model.name = f"{s.name}_{self.setting.form[0]}{self.setting.condensed}{self.setting.mode[0].lower()}"
        model.x, model.u = v, u
        model.p = ca.vertcat(stage, *extra, *([here, following] if self._tangent else []))
        model.disc_dyn_expr = ca.cse(after)
        model.cost_y_expr, model.cost_y_expr_e = ca.cse(values), ca.cse(last_values)
        ocp = module.AcadosOcp()
        ocp.model = model
        ocp.code_export_directory = str(Path(self._scratch.name) / "c")
        ocp.cost.cost_type, ocp.cost.cost_type_e = "NONLINEAR_LS", "NONLINEAR_LS"
        ocp.cost.W, ocp.cost.W_e = (np.diag(np.array(ca.evalf(w)).ravel()) for w in (weights, last_weights))
        ocp.cost.yref, ocp.cost.yref_e = np.zeros(values.numel()), np.zeros(last_values.numel())
        ocp.parameter_values = np.zeros(model.p.numel())
        b = s.bounds
        if s.nu and np.isfinite(np.concatenate([b.u_lower, b.u_upper])).all():
            ocp.constraints.lbu, ocp.constraints.ubu = b.u_lower, b.u_upper
            ocp.constraints.idxbu = np.arange(s.nu)
        index = np.array(b.states, dtype=int) - (shift if self._tangent else 0)
        if index.size:
            for end in ("", "_e"):
                setattr(ocp.constraints, f"lbx{end}", b.x_lower)
                setattr(ocp.constraints, f"ubx{end}", b.x_upper)
                setattr(ocp.constraints, f"idxbx{end}", index)
        ocp.constraints.x0 = np.zeros(size)
        options = ocp.solver_options
        if hasattr(options, "N_horizon"):
            options.N_horizon = N
        else:
            ocp.dims.N = N
        options.tf = float(t.times[-1])
        if not uniform:
            options.time_steps = np.diff(t.times)
        options.integrator_type = "DISCRETE"
        options.nlp_solver_type = "SQP_RTI"
        options.hessian_approx = "GAUSS_NEWTON"
        options.levenberg_marquardt = float(s.damping)
        options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
        options.qp_solver_cond_N = self.setting.condensed
        options.hpipm_mode = self.setting.mode
        options.qp_solver_iter_max = ITERATIONS
        options.qp_solver_warm_start = 0
        options.qp_tol = TOLERANCE
        options.ext_fun_compile_flags = FLAGS
        return ocp

    def reset(self) -> None:
        """Nothing is kept from sample to sample: HPIPM starts cold, and every trajectory is given."""

    def _set(self, sample: Sample) -> None:
        s, t, solver = self._t.statement, self._t, self._solver
        states = list(s.bounds.states)
        uniform = np.ptp(np.diff(t.times)) < 1e-12 and np.ptp(t.gains) < 1e-12
        for k in range(t.steps + 1):
            j = min(k, t.steps - 1)
            parts = [sample.stages[k]]
            if not uniform:
                parts += [[t.times[j + 1] - t.times[j]], t.gains[j]]
            if self._tangent:
                parts += [sample.x[k], sample.x[min(k + 1, t.steps)]]
            solver.set(k, "p", np.concatenate(parts))
            solver.set(k, "x", np.zeros(s.ndx) if self._tangent else sample.x[k])
            if k < t.steps:
                solver.set(k, "u", sample.u[k])
            if k and states and self._tangent:
                solver.constraints_set(k, "lbx", s.bounds.x_lower - sample.x[k][states])
                solver.constraints_set(k, "ubx", s.bounds.x_upper - sample.x[k][states])

    def _measure(self, sample: Sample) -> None:
        solver, t = self._solver, self._t
        start = sample.measured
        if self._tangent:
            start = np.array(t.difference(sample.x[0], sample.measured)).ravel()
        solver.constraints_set(0, "lbx", start)
        solver.constraints_set(0, "ubx", start)
        if t.bounds.lag is not None:
            lower, upper = first_bounds(t, sample.measured)
            solver.constraints_set(0, "lbu", lower)
            solver.constraints_set(0, "ubu", upper)

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        """One preparation and one feedback."""
        solver = self._solver
        self._set(sample)
        solver.options_set("rti_phase", 1)
        solver.solve()
        prepare = self._stat("time_tot")
        self._measure(sample)
        solver.options_set("rti_phase", 2)
        status = solver.solve()
        feedback = self._stat("time_tot")
        solution, own = self._solution(sample) if full else (None, None)
        return Answer(
            u0=np.array(solver.get(0, "u")),
            prepare=prepare,
            feedback=feedback,
            total=prepare + feedback,
            usable=status in (0, 2, 5),
            solution=solution,
            own=own,
            work=float(np.sum(self._solver.get_stats("qp_iter"))),
            parts={"hpipm": self._stat("time_qp_solver_call"), "condensing": self._stat("time_qp_xcond")},
        )

    def _stat(self, field: str) -> float:
        return 1e6 * float(np.ravel(self._solver.get_stats(field))[0])

    def _solution(self, sample: Sample) -> tuple[Solution, Qp | None]:
        t, solver, m = self._t, self._solver, self._t.statement.nu
        rows = len(t.bounds.states)
        x = np.array([solver.get(k, "x") for k in range(t.steps + 1)])
        u = np.array([solver.get(k, "u") for k in range(t.steps)])
        if not self._tangent:
            x = x - sample.x
        multipliers_u, multipliers_x = np.zeros((t.steps, m)), np.zeros((t.steps, rows))
        for k in range(t.steps + 1):
            lower, upper = np.split(np.array(solver.get(k, "lam")), 2)
            y = upper - lower
            held = 0
            if k < t.steps and y.size >= m and np.isfinite(t.bounds.u_lower).all():
                multipliers_u[k] = y[:m]
                held = m
            if k:
                multipliers_x[k - 1] = y[held : held + rows]
        answer = Solution(x, u - sample.u, np.concatenate([multipliers_u.ravel(), multipliers_x.ravel()]))
        return answer, None if self._tangent else self._qp(sample)

    def _qp(self, sample: Sample) -> Qp:
        """acados' own quadratic programme, read back."""
        t, get = self._t, self._solver.get_from_qp_in
        N, b = t.steps, t.bounds

        def stack(field: str, count: int, flat: bool = False) -> Array:
            rows = [np.array(get(k, field)) for k in range(count)]
            return np.array([r.ravel() for r in rows] if flat else rows)

        def whole(field: str, count: int) -> Array:
            lower = np.tril(stack(field, count))
            return lower + np.transpose(np.tril(lower, -1), (0, 2, 1))

        here = sample.x[:, list(b.states)]
        lower, upper = np.tile(b.u_lower, (N, 1)), np.tile(b.u_upper, (N, 1))
        lower[0], upper[0] = first_bounds(t, sample.measured)
        return Qp(
            stack("A", N),
            stack("B", N),
            stack("b", N, flat=True),
            whole("Q", N + 1),
            stack("S", N),
            whole("R", N),
            stack("q", N + 1, flat=True),
            stack("r", N, flat=True),
            sample.measured - sample.x[0],
            lower - sample.u,
            upper - sample.u,
            b.x_lower - here,
            b.x_upper - here,
            np.array(b.states, dtype=int),
        )


def _version() -> str:
    file = Path(os.environ["ACADOS_SOURCE_DIR"]) / "version"
    if file.is_file():
        return file.read_text().strip()
    for name in ("acados_template", "comma-deps-acados"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            return f"{importlib.metadata.version(name)} ({name})"
    return "not stated by the installation"


@contextlib.contextmanager
def _quiet() -> Any:
    """Without what compilers and code generators print; acados changes the folder, which is restored."""
    folder = Path.cwd()
    sys.stdout.flush()
    kept = [os.dup(n) for n in (1, 2)]
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        for n in (1, 2):
            os.dup2(nothing, n)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        for n, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, n)
            os.close(copy)
        os.close(nothing)
        os.chdir(folder)
