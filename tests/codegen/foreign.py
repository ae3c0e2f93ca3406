"""What the tests of foreign back ends share: building, two steps from an offset, random programmes, hostile ones."""

import os
import subprocess
from pathlib import Path

import jinja2
import numpy as np
from native import SANITIZED, run

from aerotact.codegen.backends import find_backend
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.codegen.qp_structure import QpPattern
from aerotact.controller import Controller, Status
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array
from aerotact.qp.solver import QpStatus

CFLAGS = "-O1 -fno-stack-protector -U_FORTIFY_SOURCE"


def build(folder: Path, *command: str) -> str:
    environment = {**os.environ, "CFLAGS": CFLAGS}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout}\n{done.stderr[:4000]}"
    return done.stdout


def stepped(ocp: Ocp, offset: list[float]) -> tuple[Array, Status, int]:
    """Command after two steps from `offset` m beside hover, worst status and iterations."""
    controller = Controller(mpc_project(ocp))
    for name, value in ocp.model.state.unpack(ocp.model.hover_state).items():
        if name in controller.measurement:
            controller.measurement[name][:] = value
    controller.measurement["p_WB"][:] += offset
    status, iterations = Status.OK, 0
    for _ in range(2):
        status = max(status, controller.step())
        iterations = max(iterations, controller.statistics.qp_iterations)
    return controller.output["thrust_cmd"].copy(), status, iterations


def random_qp(rng: np.random.Generator, pattern: QpPattern) -> dict[str, Array]:
    """Stable dynamics, a convex cost, bounds of which some are active at the solution."""
    N, nx, nu, nb = pattern.steps, pattern.nx, pattern.nu, len(pattern.bounded)
    J = rng.normal(size=(N + 1, nx + nu, nx + nu))
    H = np.swapaxes(J, 1, 2) @ J + 0.1 * np.eye(nx + nu)
    A = np.eye(nx) + 0.2 * rng.normal(size=(N, nx, nx))
    return {
        **{"A": A, "B": rng.normal(size=(N, nx, nu)), "b": 0.1 * rng.normal(size=(N, nx)), "x0": rng.normal(size=nx)},
        **{"Q": H[:, :nx, :nx], "S": H[:N, nx:, :nx], "R": H[:N, nx:, nx:]},
        **{"q": rng.normal(size=(N + 1, nx)), "r": rng.normal(size=(N, nu))},
        **{"lbu": np.full((N, nu), -0.1), "ubu": np.full((N, nu), 0.2)},
        **{"lbx": np.full((N + 1, nb), -np.inf), "ubx": np.full((N + 1, nb), 3.0)},
    }


def hostile_counts(folder: Path, backend: str, solves: int) -> dict[QpStatus, int]:
    """How often each status came from hostile data under sanitisers; see hostile_qp.c.jinja."""
    pattern, name = QpPattern(nx=3, nu=2, steps=3, bounded=(1, 2)), "tiny"
    chosen = find_backend(backend, "here")
    template = jinja2.Environment(undefined=jinja2.StrictUndefined).from_string(
        (Path(__file__).parent / "hostile_qp.c.jinja").read_text()
    )
    harness = template.render(
        name=name, NAME=name.upper(), nx=pattern.nx, nu=pattern.nu, steps=pattern.steps, bounded=2, solves=solves
    )
    files = {**chosen.sources(name, pattern), "manifest.json": "{}\n"}
    project = CProject(name, files, (f"src/{name}_qp.c",), chosen.linked)
    return dict(zip(QpStatus, map(int, run(folder, project, harness, SANITIZED).split()), strict=True))
