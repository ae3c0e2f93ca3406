"""The linearisation of all stages at once equals CasADi's of each, for every number of lanes."""

import re
from collections.abc import Callable
from typing import Any

import casadi as ca
import cffi
import numpy as np
import pytest
from sampling import sample

from aerotact.codegen.build import FLAGS, compile_library
from aerotact.codegen.lanes import Strided, emit_stages
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.codegen.templating import templates
from aerotact.exceptions import CodegenError
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

TOLERANCE = 1e-10  # relative to the largest entry of a result
WIDTHS = (1, 2, 4, 8)


def _call(project: CProject, flags: tuple[str, ...], arrays: list[Array], stages: int) -> None:
    ffi = cffi.FFI()
    head = re.search(r"^void \w+_linearise\(.*;$", project.files[f"src/{project.name}_functions.h"], flags=re.MULTILINE)
    assert head is not None
    ffi.cdef(head[0])
    library: Any = ffi.dlopen(str(compile_library(project, flags)))
    function = getattr(library, f"{project.name}_linearise")
    function(stages, *(ffi.cast("double *", a.ctypes.data) for a in arrays))


@pytest.mark.parametrize("width", WIDTHS)
def test_all_stages_equal_casadi(width: int, hexarotor_ocp: Ocp) -> None:
    ocp, rng = hexarotor_ocp, np.random.default_rng(7)
    model, project = ocp.model, mpc_project(ocp)
    n, stages = ocp.steps, ocp.targets.stage
    x = np.array([sample(model.state, rng) for _ in range(n + 1)])
    u = rng.uniform(-80.0, 80.0, (n, model.control.size))
    p = np.array([sample(stages, rng) for _ in range(n)])
    weights = np.abs(sample(ocp.targets.block.parameters, rng, spread=0.1))
    h = np.diff(ocp.times)
    expected = [ocp.linearise(x[k], u[k], x[k + 1], p[k], weights, h[k], ocp.gains[k]) for k in range(n)]
    results = [np.full((n, expected[0][i].numel()), np.nan) for i in range(len(expected[0]))]
    flags = (*FLAGS, f"-DAEROTACT_LANES={width}", "-Wno-psabi")
    _call(project, flags, [x, u, x[1:].copy(), p, weights, h, ocp.gains.copy(), *results], n)
    fixed = emit_stages(ocp.linearise, "f", _strided(7), _strided(8)).constants
    for i, result in enumerate(results):
        wanted = np.array([e[i].full().ravel() for e in expected])
        for entry, value in fixed[f"a{i}"].items():
            assert np.isnan(result[:, entry]).all(), "what is fixed is not written"
            result[:, entry] = value
        assert np.isfinite(result).all()
        np.testing.assert_allclose(result, wanted, rtol=0, atol=TOLERANCE * max(1.0, np.abs(wanted).max()))


def _strided(count: int) -> list[Strided]:
    return [Strided(f"a{i}", 1) for i in range(count)]


@pytest.mark.parametrize("width", WIDTHS)
def test_sine_cosine_and_exponential_are_those_of_the_library(width: int, run_c: Callable[..., str]) -> None:
    rng = np.random.default_rng(13)
    angles = [rng.uniform(-s, s, 500) for s in (1e-3, 1.0, 10.0, 1e3, 1e5, 1e9)]
    edges = [0.0, -0.0, np.pi / 4, np.pi / 2, np.pi, -3 * np.pi / 2, 1e-300, 699.0, -699.0, 705.0, -745.5, 1e300]
    a = np.concatenate([*angles, edges])
    a = np.concatenate([a, np.zeros(-len(a) % 8)])
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [ca.sin(x), ca.cos(x), ca.exp(x)])
    stages = emit_stages(function, "f", [Strided("a", 1)], [Strided(n, 1) for n in ("s", "c", "e")])
    header = templates().get_template("lanes.h.jinja").render(NAME="T", lane_functions=stages.math)
    n, data = len(a), ", ".join(f"{v:.17g}" for v in a)
    main = (
        f"#include <stdio.h>\nstatic const double a[{n}] = {{{data}}};\n"
        f"int main(void) {{ static double s[{n}], c[{n}], e[{n}]; int i; f({n}, a, s, c, e);"
        f' for (i = 0; i < {n}; ++i) printf("%.17g %.17g %.17g\\n", s[i], c[i], e[i]); return 0; }}\n'
    )
    printed = run_c(f"{header}\nstatic {stages.source}\n{main}", f"-DAEROTACT_LANES={width}", "-Wno-psabi")
    got = np.array([float(v) for v in printed.split()]).reshape(n, 3)
    with np.errstate(over="ignore"):
        expected = np.stack([np.sin(a), np.cos(a), np.exp(a)], axis=1)
    np.testing.assert_allclose(got[:, :2], expected[:, :2], rtol=5e-16, atol=2e-16)
    np.testing.assert_allclose(got[:, 2], expected[:, 2], rtol=5e-16)


OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "arithmetic": lambda a, b: (a + b) * (a - b) / (b * b + 1) - 2 * a,
    "selection": lambda a, b: ca.if_else(a < b, ca.sin(a), b / a) + ca.fmin(a, b) * ca.fmax(a, 0.3),
    "logic": lambda a, b: ca.logic_or(ca.logic_and(a > 0, b > 0), ca.logic_not(a <= b)) + (a == b) + (a != b),
    "functions": lambda a, b: (
        ca.sqrt(a * a + 1) + ca.exp(-a * a) + ca.cos(b) + ca.fabs(a) + ca.log1p(b * b) + 1 / (2 + a * a)
    ),
}


@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("width", WIDTHS)
def test_operations_equal_casadi(name: str, width: int, run_c: Callable[..., str]) -> None:
    rng = np.random.default_rng(11)
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    function = ca.Function("f", [a, b], [OPERATIONS[name](a, b)])
    stages = emit_stages(function, "f", [Strided("a", 1), Strided("b", 1)], [Strided("c", 1)])
    values = rng.normal(size=(13, 2))  # no multiple of any width
    values[3, 0] = values[3, 1]
    header = templates().get_template("lanes.h.jinja").render(NAME="T", lane_functions=stages.math)
    data = ", ".join(f"{v:.17g}" for v in values.T.ravel())
    main = (
        f"#include <stdio.h>\nstatic const double ab[26] = {{{data}}};\n"
        "int main(void) { double c[13]; int i; f(13, ab, ab + 13, c);"
        ' for (i = 0; i < 13; ++i) printf("%.17g\\n", c[i]); return 0; }\n'
    )
    printed = run_c(f"{header}\nstatic {stages.source}\n{main}", f"-DAEROTACT_LANES={width}", "-Wno-psabi")
    expected = [float(function(*row)) for row in values]
    np.testing.assert_allclose([float(v) for v in printed.split()], expected, rtol=1e-14, atol=1e-15)


def test_what_has_no_lane_form_is_refused() -> None:
    a = ca.SX.sym("a")
    with pytest.raises(CodegenError, match="no C form for lanes"):
        emit_stages(ca.Function("f", [a], [ca.atan2(a, 2 * a)]), "f", [Strided("a", 1)], [Strided("c", 1)])
