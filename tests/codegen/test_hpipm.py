"""The back end hpipm: what it writes, what it says where HPIPM is not found, and where it is found, right answers."""

import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign import build, hostile_counts, random_qp, stepped
from native import run

from aerotact.codegen.backends import find_backend
from aerotact.codegen.linked import find_library
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern
from aerotact.controller import Status
from aerotact.dynamics.model import Model
from aerotact.exceptions import LibraryNotFound
from aerotact.experiments import find_experiment
from aerotact.flight import fly
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array
from aerotact.qp.solver import QpResult, QpSolver, QpStatus

LIBRARIES = ("hpipm", "blasfeo")
SMALL = QpPattern(nx=4, nu=2, steps=5, bounded=(1, 3))
EVERYTHING = QpPattern(4, 2, 5, bounded=(1, 3), general=2, soft_bounds=(False, True), soft_rows=(True, False))


def _missing() -> str:
    try:
        for name in LIBRARIES:
            find_library(name)
    except LibraryNotFound as error:
        return str(error)
    return ""


needs_hpipm = pytest.mark.skipif(bool(_missing()), reason=_missing() or "found")


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory, hexarotor_ocp: Ocp) -> Path:
    """The problem of models/tilt_hex, solved by HPIPM."""
    path = tmp_path_factory.mktemp("ocp") / "other_admittance.toml"
    path.write_text(hexarotor_ocp.path.read_text().replace('backend = "aerotact"', 'backend = "hpipm"'))
    return path


@pytest.fixture(scope="module")
def ocp(problem: Path, hexarotor: Model) -> Ocp:
    return load_ocp(problem, hexarotor)


@pytest.fixture(scope="module")
def project(ocp: Ocp) -> CProject:
    return mpc_project(ocp)


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty folder that HPIPM_DIR and BLASFEO_DIR name."""
    for variable in ("HPIPM_DIR", "BLASFEO_DIR"):
        monkeypatch.setenv(variable, str(tmp_path))
    return tmp_path


def _install(folder: Path, name: str, header: str, include: str = "include") -> None:
    """A folder that looks like an installation."""
    (folder / include).mkdir(parents=True, exist_ok=True)
    (folder / include / header).touch()
    (folder / "lib").mkdir(exist_ok=True)
    (folder / "lib" / f"lib{name}.so").touch()


# text


def test_generating_again_gives_the_same_bytes(project: CProject, ocp: Ocp) -> None:
    assert dict(mpc_project(ocp).files) == dict(project.files)


def test_caveat_stands_where_users_look(project: CProject, ocp: Ocp) -> None:
    caveat = find_backend("hpipm", "here").caveat
    assert project.manifest["caveat"] == caveat
    assert project.manifest["ocp"]["backend"] == "hpipm"
    assert caveat in project.files["README.md"]
    assert caveat in project.files[f"include/{ocp.name}.h"]


def test_headers_include_nothing_of_hpipm_and_nothing_is_carried_along(project: CProject) -> None:
    assert project.linked == LIBRARIES
    assert not project.third_party
    for path, text in project.files.items():
        foreign = [name for name in re.findall(r"#include <(\w+)", text) if name.startswith(LIBRARIES)]
        assert bool(foreign) == path.endswith("_qp.c"), path


def test_allocation_is_not_called(project: CProject) -> None:
    text = re.sub(r"/\*.*?\*/", "", project.files[f"src/{project.name}_qp.c"], flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|realloc|free|exit|printf)\b", text)


def test_entries_that_are_known_are_written_for_hpipm() -> None:
    pattern = QpPattern(nx=2, nu=1, steps=3, A=[[ONE, FREE], [ZERO, FREE]], B=[[ZERO], [FREE]])
    text = find_backend("hpipm", "here").sources("known", pattern)["src/known_qp.c"]
    assert re.search(r"A_zero\[1\] = \{\s*2,\s*\}", text)
    assert re.search(r"A_one\[1\] = \{\s*0,\s*\}", text)
    assert re.search(r"B_zero\[1\] = \{\s*0,\s*\}", text)


def test_not_found_is_one_line_that_says_what_to_do(nowhere: Path) -> None:
    with pytest.raises(LibraryNotFound) as caught:
        QpSolver(SMALL, "hpipm")
    message = str(caught.value)
    assert "\n" not in message
    assert str(nowhere) in message
    for word in ("hpipm", "HPIPM_DIR", "ACADOS_SOURCE_DIR", "another back end"):
        assert word in message


def test_make_and_cmake_say_it_too(nowhere: Path, project: CProject) -> None:
    folder = nowhere / "project"
    project.write(folder)
    made = subprocess.run(["make"], cwd=folder, capture_output=True, text=True, check=False)
    assert made.returncode != 0
    assert "the library hpipm was not found" in made.stderr
    assert "HPIPM_DIR" in made.stderr
    assert subprocess.run(["make", "clean"], cwd=folder, capture_output=True, check=False).returncode == 0


def test_own_variable_comes_before_acados(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    own, acados = tmp_path / "own", tmp_path / "acados"
    for name, header in zip(LIBRARIES, ("hpipm_d_ocp_qp_ipm.h", "blasfeo_d_aux.h"), strict=True):
        _install(own, name, header)
        _install(acados, name, header, f"include/{name}/include")
    monkeypatch.setenv("ACADOS_SOURCE_DIR", str(acados))
    monkeypatch.setenv("HPIPM_DIR", str(own))
    monkeypatch.delenv("BLASFEO_DIR", raising=False)
    assert find_library("hpipm").include == own / "include"
    assert find_library("blasfeo").include == acados / "include" / "blasfeo" / "include"
    (own / "lib" / "libhpipm.so").unlink()
    with pytest.raises(LibraryNotFound, match=re.escape(str(own))):
        find_library("hpipm")


# building


@needs_hpipm
def test_makes_as_c_and_as_cpp(tmp_path: Path, project: CProject) -> None:
    project.write(tmp_path)
    printed = build(tmp_path, "make", "-s", "check")
    assert len(re.findall(rf"^{project.name}: \d+ steps, 0 not OK", printed, flags=re.MULTILINE)) == 2, printed


@needs_hpipm
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_passes_ctest(tmp_path: Path, project: CProject) -> None:
    project.write(tmp_path)
    build(tmp_path, "cmake", "-B", "build", "-S", ".", "-DCMAKE_BUILD_TYPE=Debug")
    build(tmp_path, "cmake", "--build", "build")
    assert "100% tests passed" in build(tmp_path, "ctest", "--test-dir", "build")


COUNTED = """
#include <stdio.h>
#include <string.h>
#include "counted_qp.h"
extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
static int calls;
void *malloc(size_t size) { ++calls; return __libc_malloc(size); }
void *calloc(size_t count, size_t size) { ++calls; return __libc_calloc(count, size); }
static counted_qp_workspace here, there;
static counted_qp_data data;
static counted_qp_solution first, second;
int main(void)
{
    counted_qp_settings settings;
    int k, i;
    void *volatile used = malloc(8);
    const int before = calls;
    counted_qp_default_settings(&settings);
    for (k = 0; k <= COUNTED_QP_N; ++k)
        for (i = 0; i < COUNTED_QP_NX; ++i) {
            data.Q[k][i * (COUNTED_QP_NX + 1)] = 1.0;
            data.x0[i] = 1.0 + i;
            if (k < COUNTED_QP_N) {
                data.A[k][i * (COUNTED_QP_NX + 1)] = 1.1;
                data.B[k][i * COUNTED_QP_NU + i % COUNTED_QP_NU] = 1.0;
                data.R[k][i % COUNTED_QP_NU * (COUNTED_QP_NU + 1)] = 0.1;
            }
        }
    for (k = 0; k < COUNTED_QP_N; ++k)
        for (i = 0; i < COUNTED_QP_NU; ++i)
            data.lbu[k][i] = -(data.ubu[k][i] = 0.5);
    counted_qp_init(&here);
    if (counted_qp_solve(&data, &settings, &here, &first) != COUNTED_QP_OK)
        return 2;
    memcpy(&there, &here, sizeof(there)); /* a copy has the wrong addresses and must notice */
    memset(&here, 255, sizeof(here));
    if (counted_qp_solve(&data, &settings, &there, &second) != COUNTED_QP_OK)
        return 3;
    printf("%d %d %d", before, calls - before, memcmp(&first, &second, sizeof(first)));
    return used == NULL;
}
"""


@needs_hpipm
def test_nothing_is_allocated_and_a_workspace_may_move(tmp_path: Path) -> None:
    chosen = find_backend("hpipm", "here")
    files = {**chosen.sources("counted", QpPattern(nx=5, nu=2, steps=8)), "manifest.json": "{}\n"}
    project = CProject("counted", files, ("src/counted_qp.c",), chosen.linked)
    before, during, different = map(int, run(tmp_path, project, COUNTED).split())
    assert before > 0
    assert during == different == 0


@needs_hpipm
@pytest.mark.parametrize("size", [(1, 1, 1), (2, 5, 3), (17, 3, 20), (40, 16, 50)])
def test_memory_suffices_for_every_size(size: tuple[int, int, int]) -> None:
    nx, nu, steps = size
    pattern = QpPattern(nx, nu, steps, bounded=tuple(range(nx)), general=2, soft_rows=(True, False))
    data: dict[str, Any] = {
        **{"Q": np.tile(np.eye(nx), (steps + 1, 1, 1)), "R": np.tile(np.eye(nu), (steps, 1, 1)), "x0": np.ones(nx)},
        **{"lbu": -np.ones((steps, nu)), "ubu": np.ones((steps, nu)), "soft_g_lin": np.ones((steps + 1, 2))},
        **{"lbx": np.full((steps + 1, nx), -np.inf), "ubx": np.full((steps + 1, nx), 2.0)},
        **{"lg": np.full((steps + 1, 2), -1.0), "ug": np.full((steps + 1, 2), np.inf)},
    }
    assert QpSolver(pattern, "hpipm").solve(data).status is QpStatus.OK


# solving


@needs_hpipm
def test_first_command_is_that_of_the_default_back_end(ocp: Ocp, hexarotor_ocp: Ocp) -> None:
    cases = [([0.002, -0.001, 0.001], 1e-4), ([0.05, -0.05, 0.02], 1e-4), ([0.5, -0.4, 0.3], 1e-3)]  # m, N
    for offset, tolerance in cases:
        expected, status, _ = stepped(hexarotor_ocp, offset)
        found, other_status, iterations = stepped(ocp, offset)
        assert status is other_status is Status.OK
        assert iterations > 0
        np.testing.assert_allclose(found, expected, atol=tolerance)


def _with_rows(rng: np.random.Generator, pattern: QpPattern) -> dict[str, Array]:
    """A random programme with general rows and penalties of what is soft."""
    N, ng, nb = pattern.steps, pattern.general, len(pattern.bounded)
    data = random_qp(rng, pattern)
    limits = {"lbx": np.full((N + 1, nb), -np.inf), "ubx": rng.uniform(0.1, 3.0, (N + 1, nb))}
    rows = {"C": rng.normal(size=(N + 1, ng, pattern.nx)), "D": rng.normal(size=(N, ng, pattern.nu))}
    sides = {"lg": np.full((N + 1, ng), -8.0), "ug": rng.uniform(0.5, 9.0, (N + 1, ng))}
    sides["ug"][0] = np.inf
    prices = {f"soft_{v}_{p}": rng.uniform(0.1, 10.0, (N + 1, 2)) for v in ("x", "g") for p in ("lin", "quad")}
    return {**data, **limits, **rows, **sides, **prices}


@needs_hpipm
@pytest.mark.parametrize("rows", [False, True], ids=["bounds", "rows"])
def test_random_programmes_have_the_same_solution(rows: bool) -> None:
    pattern = EVERYTHING if rows else SMALL
    ours, hpipm = QpSolver(pattern), QpSolver(pattern, "hpipm")
    rng = np.random.default_rng(7)
    statuses: Counter[QpStatus] = Counter()
    active = 0
    for _ in range(60):
        data = _with_rows(rng, pattern) if rows else random_qp(rng, pattern)
        expected, found = ours.solve(data), hpipm.solve(data)
        assert found.status is expected.status
        statuses[found.status] += 1
        if found.status is not QpStatus.OK:
            continue
        for name in ("x", "u", "pi", "y"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-3, err_msg=name)
        assert max(found.stationarity, found.feasibility, found.complementarity) < 1e-6
        active += np.any(np.abs(expected.y) > 1e-3)
    assert statuses[QpStatus.OK] > 30
    assert statuses[QpStatus.INFEASIBLE] > 0
    assert active > 20


@needs_hpipm
def test_entries_that_are_known_are_not_read() -> None:
    rng = np.random.default_rng(5)
    pattern = QpPattern(4, 2, 5, (1, 3), A=np.where(np.eye(4), ONE, [[FREE, FREE, ZERO, ZERO]] * 4).tolist())
    data = random_qp(rng, pattern)
    data["A"] = np.where(np.eye(4), 1.0, data["A"] * [1, 1, 0, 0])
    spoilt = {**data, "A": np.where(np.array(pattern.A) == FREE, data["A"], np.nan)}
    clean, dirty = (QpSolver(pattern, "hpipm").solve(d) for d in (data, spoilt))
    assert clean.status is dirty.status is QpStatus.OK
    np.testing.assert_array_equal(clean.u, dirty.u)
    np.testing.assert_allclose(clean.u, QpSolver(SMALL).solve(data).u, atol=1e-6)


@needs_hpipm
def test_statuses() -> None:
    solver = QpSolver(SMALL, "hpipm")
    data = random_qp(np.random.default_rng(3), SMALL)
    assert solver.solve(data).status is QpStatus.OK
    assert solver.solve({**data, "lbu": data["ubu"] + 1.0}).status is QpStatus.INFEASIBLE
    assert solver.solve(data).status is QpStatus.OK
    assert solver.solve({"ubx": np.full((6, 2), -1e3)}).status is QpStatus.INFEASIBLE
    for name in ("A", "Q", "r", "lbu", "x0"):
        spoilt = solver.solve({**data, name: np.full_like(np.asarray(data[name]), np.nan)})
        assert spoilt.status is QpStatus.NUMERICAL, name
        assert np.isfinite(spoilt.u).all()
    assert solver.solve(data).status is QpStatus.OK
    solver.settings.max_iterations = 3
    stopped = solver.solve(data)
    assert stopped.status is QpStatus.MAX_ITERATIONS
    assert stopped.iterations == 3
    assert max(stopped.stationarity, stopped.feasibility, stopped.complementarity) > 1e-6
    assert (stopped.u >= data["lbu"]).all()
    assert (stopped.u <= data["ubu"]).all()


def _stopped_by_clock(solver: QpSolver, data: dict[str, Array], allowed: int) -> tuple[QpResult, int]:
    """Answer when `allowed` readings of the clock are in time, and how often it was read."""
    readings = 0

    def read(_: object) -> float:
        nonlocal readings
        readings += 1
        return float(readings > allowed)

    clock = solver._ffi.callback("double(void *)", read)
    solver.settings.clock, solver.settings.deadline = clock, 0.5
    answer = solver.solve(data)
    solver.settings.clock = solver._ffi.NULL
    return answer, readings


@needs_hpipm
def test_clock_is_asked_between_iterations_and_changes_nothing() -> None:
    solver = QpSolver(SMALL, "hpipm")
    data = random_qp(np.random.default_rng(3), SMALL)
    whole = solver.solve(data)
    answer, readings = _stopped_by_clock(solver, data, 1000)
    assert answer.status is QpStatus.OK
    assert 1 < readings < 10
    np.testing.assert_allclose(answer.u, whole.u, atol=1e-6)
    for allowed in (0, 1):
        late, readings = _stopped_by_clock(solver, data, allowed)
        assert late.status is QpStatus.DEADLINE
        assert readings == allowed + 1
        assert np.isfinite(late.u).all()
    assert solver.solve(data).status is QpStatus.OK


@needs_hpipm
def test_hostile_programmes_leave_no_trace_under_sanitisers(tmp_path: Path) -> None:
    solves = 4000
    counts = hostile_counts(tmp_path, "hpipm", solves)
    assert sum(counts.values()) == solves
    assert min(counts[s] for s in (QpStatus.OK, QpStatus.INFEASIBLE, QpStatus.NUMERICAL)) > solves // 50, counts


@needs_hpipm
def test_free_flight_is_tracked(problem: Path) -> None:
    tour = find_experiment("ryll2019/free-flight")
    result = fly(tour, tour.cases[0], str(problem), 0)[1]
    metrics = {name: metric.value for name, metric in result.metrics.items()}
    assert result.fault == ""
    assert metrics["position_error_max"] < 20e-3  # m
    assert metrics["stand_ins"] == 0
    assert metrics["violations_thrust"] == metrics["violations_thrust_rate"] == 0
