"""Single precision: what is written holds no double, compiles without a hidden one, and gives what doubles give."""

import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign import build, random_qp

from aerotact.bench.peers.aerotact_peer import AerotactPeer
from aerotact.bench.problems import make_problem
from aerotact.bench.scenario import record
from aerotact.codegen.build import find_compiler
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.precision import in_single_precision
from aerotact.codegen.project import CProject, block_project
from aerotact.codegen.qp_structure import QpPattern
from aerotact.codegen.templating import templates
from aerotact.controller import Controller, Status
from aerotact.dynamics.model import Model
from aerotact.estimation import estimators
from aerotact.exceptions import CodegenError, ProblemError
from aerotact.experiments import find_experiment
from aerotact.flight import fly
from aerotact.laws import laws
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array
from aerotact.qp.solver import QpSolver, QpStatus

PEDANTIC = ("-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion", "-Wfloat-conversion")
CORTEX_M = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")
ARM_GCC = "arm-none-eabi-gcc"
BLOCKS = ("ryll2019_admittance", "state_estimator", "wrench_observer")


@pytest.fixture(scope="module")
def project(hexarotor_ocp: Ocp) -> CProject:
    return mpc_project(hexarotor_ocp, "single")


def _problem(folder: Path, ocp: Ocp, **keys: str) -> Path:
    """The problem of `ocp` with other keys of [solver]."""
    text = ocp.path.read_text()
    for key, value in keys.items():
        text = re.sub(rf"^{key} = .*\n", "", text, flags=re.MULTILINE)
        text = text.replace("[solver]\n", f'[solver]\n{key} = "{value}"\n')
    path = folder / "single_admittance.toml"
    path.write_text(text)
    return path


# text


@pytest.mark.parametrize(
    ("double", "single"),
    [
        ("double x = 1.5;", "float x = 1.5f;"),
        ("x = sqrt(fabs(y)) + .5e-3 * 2e3;", "x = sqrtf(fabsf(y)) + .5e-3f * 2e3f;"),
        ("lane_sin(a) + sine + my.exp(b)", "lane_sin(a) + sine + my.expf(b)"),
        ('/* double 1.0 */ printf("1.0 double %d\\n", 3);', '/* double 1.0 */ printf("1.0 double %d\\n", 3);'),
        ("int i = 10, j = 0x1e5u, k = a[2];", "int i = 10, j = 0x1e5u, k = a[2];"),
        ("double (*clock)(void *);", "double (*clock)(void *);"),
        ("settings.deadline = 1.0;\ny = 1.0;", "settings.deadline = 1.0;\ny = 1.0f;"),
        ("double x; /* asked of the clock */", "float x; /* asked of the clock */"),
        ("if (x > 1e-12 * y || x < 1e-200 || x > 1e300)", "if (x > 4.9e-06f * y || x < 1e-30f || x > 1e30f)"),
        ("x = 9.9999999999999998e-13 + 1e-3 + DBL_MAX;", "x = 9.9999999999999998e-13f + 1e-3f + FLT_MAX;"),
    ],
)
def test_tokens(double: str, single: str) -> None:
    assert in_single_precision(double) == single
    assert in_single_precision(single) == single


def test_no_double_is_left_but_the_clock(project: CProject, hexarotor_ocp: Ocp) -> None:
    assert dict(mpc_project(hexarotor_ocp, "single").files) == dict(project.files)
    for path, text in project.files.items():
        if not path.endswith((".c", ".h")):
            continue
        code = re.sub(r'/\*.*?\*/|"[^"\n]*"', "", text, flags=re.DOTALL)
        for line in code.split("\n"):
            assert re.search("clock|deadline", line) or not re.search(
                r"\bdouble\b|(?<![\w.])(\d+\.\d*|\d+e-?\d+)(e[-+]?\d+)?(?![\w.])", line
            ), f"{path}: {line}"


def test_the_manifest_and_the_readme_say_it(project: CProject, hexarotor_ocp: Ocp, hexarotor: Model) -> None:
    assert project.manifest["precision"] == "single"
    assert "Single precision" in project.files["README.md"]
    assert mpc_project(hexarotor_ocp).manifest["precision"] == "double"
    law = laws()["ryll2019_pose_control"](hexarotor, 500.0)
    assert block_project(law, hexarotor, "single").manifest["precision"] == "single"


def test_the_ocp_file_chooses(tmp_path: Path, hexarotor_ocp: Ocp, hexarotor: Model) -> None:
    ocp = load_ocp(_problem(tmp_path, hexarotor_ocp, precision="single"), hexarotor)
    assert mpc_project(ocp).manifest["precision"] == "single"
    assert mpc_project(ocp, "double").manifest["precision"] == "double"
    with pytest.raises(ProblemError, match=r"solver\.precision: Input should be 'double' or 'single' \(got 'half'\)"):
        load_ocp(_problem(tmp_path, hexarotor_ocp, precision="half"), hexarotor)


@pytest.mark.parametrize("backend", ["osqp", "hpipm"])
def test_other_back_ends_know_doubles_only(tmp_path: Path, hexarotor_ocp: Ocp, hexarotor: Model, backend: str) -> None:
    ocp = load_ocp(_problem(tmp_path, hexarotor_ocp, precision="single", backend=backend), hexarotor)
    with pytest.raises(CodegenError, match=f"back end {backend} knows doubles only; valid .* the back end aerotact"):
        mpc_project(ocp)


# building


@pytest.mark.parametrize("flags", [("-march=native",), ("-DAEROTACT_LANES=1",)], ids=["native", "scalar"])
def test_compiles_without_a_hidden_double(tmp_path: Path, project: CProject, flags: tuple[str, ...]) -> None:
    project.write(tmp_path)
    for source in project.sources:
        command = [*find_compiler(), "-std=c99", "-O1", *flags, *PEDANTIC, "-Iinclude", "-Isrc", "-c", source]
        done = subprocess.run([*command, "-o", "a.o"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:3000]


def test_makes_as_c_and_as_cpp(tmp_path: Path, project: CProject) -> None:
    project.write(tmp_path)
    printed = build(tmp_path, "make", "-s", "check")
    assert len(re.findall(rf"^{project.name}: \d+ steps, 0 not OK", printed, flags=re.MULTILINE)) == 2, printed


@pytest.mark.parametrize("name", BLOCKS)
def test_laws_and_estimators_pass_their_example(tmp_path: Path, hexarotor: Model, name: str) -> None:
    block = {**laws(), **estimators()}[name](hexarotor, 500.0)
    block_project(block, hexarotor, "single").write(tmp_path)
    assert re.search(r": \d+ steps, 0 not OK", build(tmp_path, "make", "-s", "check"))


@pytest.mark.skipif(shutil.which(ARM_GCC) is None, reason=f"needs {ARM_GCC}")
def test_a_small_computer_computes_no_double(tmp_path: Path, short_problem: Path, models: dict[str, Model]) -> None:
    """Cortex-M7 with a single-precision unit: doubles would be calls of its run-time library."""
    project = mpc_project(load_ocp(short_problem, models["octorotor"]), "single")
    project.write(tmp_path)
    called: set[str] = set()
    for source in project.sources:
        command = [ARM_GCC, "-std=c99", "-O1", *CORTEX_M, *PEDANTIC, "-Iinclude", "-Isrc", "-c", source, "-o", "a.o"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:3000]
        called |= {line.split()[-1] for line in build(tmp_path, "arm-none-eabi-nm", "-u", "a.o").splitlines()}
    assert "sqrtf" in called or "memcpy" in called
    clock = {"__aeabi_dadd", "__aeabi_dcmpge", "__aeabi_dcmple"}  # the sum and the comparison of the deadline
    assert {f for f in called if re.match("__aeabi_(d|l2d|ul2d|f2d|i2d|ui2d)", f)} <= clock


# solving


@pytest.mark.parametrize("name", ["H", "O"])
def test_first_control_is_that_of_the_exact_solution(name: str) -> None:
    problem = make_problem(name)
    samples = record(problem, 60 if name == "H" else 150, seed=11)
    peer = AerotactPeer(problem, precision="single")
    errors = []
    for sample in samples:
        answer = peer.solve(sample)
        assert answer.usable
        exact = sample.first_control(sample.reference.solution.u)
        errors.append(np.abs((answer.u0 - exact) / problem.control_range).max())
    assert sum(sample.saturated for sample in samples) > 20
    assert np.median(errors) < 1e-5
    assert max(errors) < 1e-3


@pytest.mark.parametrize("general", [0, 2])
def test_random_programmes_get_the_right_status(general: int) -> None:
    pattern = QpPattern(nx=4, nu=2, steps=5, bounded=(1, 3), general=general)
    single = QpPattern(nx=4, nu=2, steps=5, bounded=(1, 3), general=general, single=True)
    doubles, floats = QpSolver(pattern), QpSolver(single)
    assert floats.data["Q"].dtype == np.float32
    rng = np.random.default_rng(7)
    statuses: Counter[QpStatus] = Counter()
    for _ in range(100):
        data = random_qp(rng, pattern)
        if general:
            data |= {"C": rng.normal(size=(6, general, 4)), "D": rng.normal(size=(5, general, 2))}
            data |= {"lg": np.full((6, general), -8.0), "ug": np.full((6, general), 8.0)}
        expected, found = doubles.solve(data), floats.solve(data)
        assert all(np.isfinite(v).all() for v in (found.x, found.u, found.pi, found.y))
        statuses[found.status] += 1
        if found.status is QpStatus.OK:
            assert expected.status is QpStatus.OK
            np.testing.assert_allclose(found.u, expected.u, atol=1e-3)
        elif found.status is QpStatus.INFEASIBLE:
            assert expected.status is QpStatus.INFEASIBLE
    assert statuses[QpStatus.OK] > 80
    assert statuses[QpStatus.INFEASIBLE] > 0


def test_bad_data_is_seen() -> None:
    pattern = QpPattern(nx=4, nu=2, steps=5, bounded=(1, 3), single=True)
    solver = QpSolver(pattern)
    data = random_qp(np.random.default_rng(3), pattern)
    first = solver.solve(data)
    assert first.status is QpStatus.OK
    for name in ("A", "Q", "r", "lbu", "x0"):
        for value in (np.nan, np.inf if name != "lbu" else np.nan, 1e30 if name == "A" else np.nan):
            spoilt = solver.solve({**data, name: np.full_like(np.asarray(data[name]), value)})
            assert spoilt.status is not QpStatus.OK, (name, value)
            assert np.isfinite(spoilt.u).all()
    assert solver.solve({**data, "lbu": np.asarray(data["ubu"]) + 1.0}).status is QpStatus.INFEASIBLE
    solver.reset()
    np.testing.assert_array_equal(solver.solve(data).u, first.u)


def _commands(controller: Controller, model: Model, steps: int) -> Array:
    """Of a tool that is pushed and a base that is moved about."""
    hover = model.state.unpack(model.hover_state)
    given, commands = controller.measurement, []
    given["q_WB"][:] = hover["q_WB"]
    for k in range(steps):
        swing = [0.3 * np.sin(0.2 * k), 0.0, 0.2 * np.cos(0.3 * k)]
        given["p_WB"][:] = hover["p_WB"] + swing
        given["f_tool_W"][:] = [3.0 * np.sin(0.1 * k), 0.0, 0.0]
        assert controller.step() is Status.OK
        commands.append(controller.output["thrust_cmd"].copy())
    return np.array(commands)


def test_commands_are_those_of_doubles(project: CProject, hexarotor_ocp: Ocp, hexarotor: Model) -> None:
    single, double = (_commands(Controller(p), hexarotor, 60) for p in (project, mpc_project(hexarotor_ocp)))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, double, atol=0.02)  # N, of 12


def test_free_flight_is_tracked(tmp_path: Path, hexarotor_ocp: Ocp) -> None:
    tour = find_experiment("ryll2019/free-flight")
    problem = _problem(tmp_path, hexarotor_ocp, precision="single")
    result = fly(tour, tour.cases[0], str(problem), 0)[1]
    metrics = {name: metric.value for name, metric in result.metrics.items()}
    assert result.fault == ""
    assert metrics["position_error_max"] < 20e-3  # m
    assert metrics["stand_ins"] == 0
    assert metrics["violations_thrust"] == metrics["violations_thrust_rate"] == 0


@pytest.mark.parametrize("width", [1, 2, 4, 8, 16])
def test_sine_cosine_exponential_and_logarithm_are_those_of_the_library(width: int, run_c: Callable[..., str]) -> None:
    rng = np.random.default_rng(13)
    angles = [rng.uniform(-s, s, 500) for s in (1e-3, 1.0, 10.0, 1e3, 8e3, 1e5)]
    edges = [0.0, -0.0, np.pi / 4, np.pi / 2, np.pi, -3 * np.pi / 2, 1e-20, 86.0, -86.0, 88.0, -100.0, 1e30]
    edges += [1e-9, -0.2929, 0.4143, -0.9989, -0.9999, 1e6]
    a = np.concatenate([*angles, edges]).astype(np.float32)
    a = np.concatenate([a, np.zeros(-len(a) % 16, dtype=np.float32)])
    header = (
        templates()
        .get_template("lanes.h.jinja")
        .render(NAME="T", lane_functions=["sin", "cos", "exp", "log1p"], single=True)
    )
    main = (
        f"static const double a[{len(a)}] = {{{', '.join(f'{v:.9g}' if v % 1 else f'{v:.1f}' for v in a)}}};\n"
        f"int main(void) {{ int i, l; for (i = 0; i < {len(a)}; i += LANES) {{ lane v = {{0}}, s, c, e, g;"
        " for (l = 0; l < LANES; ++l) LANE_OF(v, l) = a[i + l];"
        " s = lane_sin(v); c = lane_cos(v); e = lane_exp(v); g = lane_log1p(v); for (l = 0; l < LANES; ++l)"
        ' printf("%.9g %.9g %.9g %.9g\\n", LANE_OF(s, l), LANE_OF(c, l), LANE_OF(e, l), LANE_OF(g, l)); } return 0; }\n'
    )
    text = in_single_precision(f"#include <stdio.h>\n{header}\n{main}")
    quiet = ("-Wno-psabi", "-Wno-unused-function", f"-DAEROTACT_LANES={width}")
    got = np.array([float(v) for v in run_c(text, *quiet).split()]).reshape(-1, 4)
    wide = a.astype(float)
    with np.errstate(over="ignore", invalid="ignore"):
        expected = np.stack([np.sin(wide), np.cos(wide), np.exp(wide).astype(np.float32), np.log1p(wide)], axis=1)
    np.testing.assert_allclose(got[:, :2], expected[:, :2], rtol=2e-7, atol=1.2e-7)
    np.testing.assert_allclose(got[:, 2:], expected[:, 2:], rtol=2e-7)
