"""The linearisation of all stages at once equals CasADi's of each, for every number of lanes."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import cffi
import numpy as np
import pytest
from sampling import sample

from aerotact.codegen.build import FLAGS, compile_library
from aerotact.codegen.lanes import StageFunction, constant_entries, emit_stages
from aerotact.codegen.project import CProject
from aerotact.codegen.templating import templates
from aerotact.exceptions import CodegenError
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array

TOLERANCE = 1e-10  # relative to the largest entry of a result
WIDTHS = (1, 2, 4, 8)
QUIET = ("-Wno-psabi", "-Wno-unused-parameter")  # lanes wider than registers; results that are all constant


def _stages(function: Any, *sizes: int) -> StageFunction:
    """The function `f` for arrays in0, in1, ... with so many numbers a stage (0: shared), and out0, out1, ..."""
    results = [function.numel_out(i) for i in range(function.n_out())]
    arguments = [f"const double *in{i}" for i in range(len(sizes))] + [f"double *out{i}" for i in range(len(results))]
    return emit_stages(
        function,
        "f",
        ", ".join(["int count", *arguments]),
        "count",
        [f"in{i} + {size} * k" for i, size in enumerate(sizes)],
        lambda result, entry: [(f"out{result} + {results[result]} * k", entry)],
    )


def _header(stages: StageFunction) -> str:
    return templates().get_template("lanes.h.jinja").render(NAME="T", lane_functions=stages.math)


def _library(stages: StageFunction, flags: tuple[str, ...]) -> Any:
    ffi = cffi.FFI()
    ffi.cdef(f"{stages.signature};")
    text = f'#include "lanes.h"\n{stages.signature};\n{stages.source}'
    project = CProject("stages", {"src/lanes.h": _header(stages), "src/f.c": text}, ("src/f.c",))
    return ffi, ffi.dlopen(str(compile_library(project, flags)))


@pytest.fixture(scope="module")
def case(hexarotor_ocp: Ocp) -> tuple[StageFunction, list[Array], list[list[Array]]]:
    """The linearisation of an ocp in C, its arguments at random, and CasADi's results, one list a stage."""
    ocp, rng = hexarotor_ocp, np.random.default_rng(7)
    model, n, layout = ocp.model, ocp.steps, ocp.targets.stage
    x = np.array([sample(model.state, rng) for _ in range(n + 1)])
    u = rng.uniform(-80.0, 80.0, (n, model.control.size))
    p = np.array([sample(layout, rng) for _ in range(n)])
    weights = np.abs(sample(ocp.targets.block.parameters, rng, spread=0.1))
    h = np.diff(ocp.times)
    rows = zip(x[:-1], u, x[1:], p, [weights] * n, h, ocp.gains, strict=True)
    expected = [[e.full().ravel() for e in ocp.linearise(*row)] for row in rows]
    stages = _stages(ocp.linearise, x.shape[1], u.shape[1], x.shape[1], p.shape[1], 0, 1, u.shape[1])
    return stages, [x, u, x[1:].copy(), p, weights, h, ocp.gains.copy()], expected


def _run(case: tuple[StageFunction, list[Array], list[list[Array]]], width: int) -> list[Array]:
    stages, arguments, expected = case
    ffi, library = _library(stages, (*FLAGS, f"-DAEROTACT_LANES={width}", *QUIET))
    results = [np.full((len(expected), len(result)), np.nan) for result in expected[0]]
    library.f(len(expected), *(ffi.cast("double *", a.ctypes.data) for a in [*arguments, *results]))
    return results


@pytest.mark.parametrize("width", WIDTHS)
def test_all_stages_equal_casadi(
    width: int, hexarotor_ocp: Ocp, case: tuple[StageFunction, list[Array], list[list[Array]]]
) -> None:
    results, fixed = _run(case, width), constant_entries(hexarotor_ocp.linearise)
    for i, result in enumerate(results):
        wanted = np.array([expected[i] for expected in case[2]])
        for entry, value in fixed[i].items():
            assert np.isnan(result[:, entry]).all(), "what is fixed is not written"
            result[:, entry] = value
        assert np.isfinite(result).all()
        np.testing.assert_allclose(result, wanted, rtol=0, atol=TOLERANCE * max(1.0, np.abs(wanted).max()))


def test_the_number_of_lanes_changes_no_bit(case: tuple[StageFunction, list[Array], list[list[Array]]]) -> None:
    one, *wider = (_run(case, width) for width in WIDTHS)
    for other in wider:
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("width", WIDTHS)
def test_sine_cosine_exponential_and_logarithm_are_those_of_the_library(width: int, run_c: Callable[..., str]) -> None:
    rng = np.random.default_rng(13)
    angles = [rng.uniform(-s, s, 500) for s in (1e-3, 1.0, 10.0, 1e3, 1e5, 1e9)]
    edges = [0.0, -0.0, np.pi / 4, np.pi / 2, np.pi, -3 * np.pi / 2, 1e-300, 699.0, -699.0, 705.0, -745.5, 1e300]
    edges += [1e-17, -0.2929, 0.4143, -0.9989, -0.9999999, 1e15]
    a = np.concatenate([*angles, edges])
    a = np.concatenate([a, np.zeros(-len(a) % 8)])
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [ca.sin(x), ca.cos(x), ca.exp(x), ca.log1p(x)])
    stages = _stages(function, 1)
    n, data = len(a), ", ".join(f"{v:.17g}" for v in a)
    main = (
        f"#include <stdio.h>\nstatic const double a[{n}] = {{{data}}};\n"
        f"int main(void) {{ static double s[{n}], c[{n}], e[{n}], l[{n}]; int i; f({n}, a, s, c, e, l);"
        f' for (i = 0; i < {n}; ++i) printf("%.17g %.17g %.17g %.17g\\n", s[i], c[i], e[i], l[i]); return 0; }}\n'
    )
    printed = run_c(f"{_header(stages)}\n{stages.source}\n{main}", f"-DAEROTACT_LANES={width}", *QUIET)
    got = np.array([float(v) for v in printed.split()]).reshape(n, 4)
    with np.errstate(over="ignore", invalid="ignore"):
        expected = np.stack([np.sin(a), np.cos(a), np.exp(a), np.log1p(a)], axis=1)
    np.testing.assert_allclose(got[:, :2], expected[:, :2], rtol=5e-16, atol=2e-16)
    np.testing.assert_allclose(got[:, 2:], expected[:, 2:], rtol=5e-16)


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
    stages = _stages(function, 1, 1)
    values = rng.normal(size=(13, 2))  # no multiple of any width
    values[3, 0] = values[3, 1]
    data = ", ".join(f"{v:.17g}" for v in values.T.ravel())
    main = (
        f"#include <stdio.h>\nstatic const double ab[26] = {{{data}}};\n"
        "int main(void) { double c[13]; int i; f(13, ab, ab + 13, c);"
        ' for (i = 0; i < 13; ++i) printf("%.17g\\n", c[i]); return 0; }\n'
    )
    printed = run_c(f"{_header(stages)}\n{stages.source}\n{main}", f"-DAEROTACT_LANES={width}", *QUIET)
    expected = [float(function(*row)) for row in values]
    np.testing.assert_allclose([float(v) for v in printed.split()], expected, rtol=1e-14, atol=1e-15)


def test_what_has_no_lane_form_is_refused() -> None:
    a = ca.SX.sym("a")
    with pytest.raises(CodegenError, match="no C form for lanes"):
        _stages(ca.Function("f", [a], [ca.atan2(a, 2 * a)]), 1)
