"""CasADi functions as C: each operation, each kind of constant, and what is refused."""

import math
import re
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import cffi
import numpy as np
import pytest

from aerotact.codegen.build import find_compiler
from aerotact.codegen.functions import emit, number
from aerotact.exceptions import CodegenError
from aerotact.ports import Array

ANY, POSITIVE, UNIT, ABOVE_ONE = (-3.0, 3.0), (0.01, 9.0), (-1.0, 1.0), (1.0, 9.0)
CONSTANTS = [
    *(0.0, 1.0, -1.0, 1.0 / 3.0, math.pi, -2.5e-17),
    *(1.7976931348623157e308, -1e300, 2.2250738585072014e-308, 5e-324, -5e-324, 123456789.0),
]
UNARY: dict[str, tuple[Any, tuple[float, float]]] = {
    **{
        n: (getattr(ca, n), ANY) for n in ("exp", "sin", "cos", "tan", "atan", "sinh", "cosh", "tanh", "asinh", "floor")
    },
    **{n: (getattr(ca, n), ANY) for n in ("ceil", "fabs", "expm1", "erf", "sign")},
    **{n: (getattr(ca, n), POSITIVE) for n in ("log", "sqrt", "log1p")},
    **{n: (getattr(ca, n), UNIT) for n in ("asin", "acos", "atanh")},
    "acosh": (ca.acosh, ABOVE_ONE),
    "neg": (lambda x: -x, ANY),
    "square": (lambda x: x * x, ANY),
    "twice": (lambda x: 2 * x, ANY),
    "inverse": (lambda x: 1 / x, POSITIVE),
    "not": (lambda x: ca.logic_not(x > 0), ANY),
    "cube": (lambda x: x**3, ANY),
    "root": (lambda x: x**2.5, POSITIVE),
}
BINARY: dict[str, tuple[Any, tuple[float, float]]] = {
    **{n: (getattr(ca, n), ANY) for n in ("fmin", "fmax", "fmod", "remainder", "atan2", "hypot", "copysign")},
    "add": (lambda x, y: x + y, ANY),
    "sub": (lambda x, y: x - y, ANY),
    "mul": (lambda x, y: x * y, ANY),
    "div": (lambda x, y: x / y, ANY),
    "pow": (lambda x, y: x**y, POSITIVE),
    "less": (lambda x, y: x < y, ANY),
    "less_or_equal": (lambda x, y: x <= y, ANY),
    "equal": (lambda x, y: ca.floor(x) == ca.floor(y), ANY),
    "not_equal": (lambda x, y: ca.floor(x) != ca.floor(y), ANY),
    "and": (lambda x, y: ca.logic_and(x > 0, y > 0), ANY),
    "or": (lambda x, y: ca.logic_or(x > 0, y > 0), ANY),
    "if_else": (lambda x, y: ca.if_else(x < y, x * y, ca.sin(x)), ANY),
}
EDGES = (0.0, -0.0, 1.0, -1.0, 2.0, 1e-300, 1e300, -1e300, 5e-324, math.inf, -math.inf, math.nan)


@pytest.fixture(scope="module")
def operations(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Any, Any]]:
    """Name -> (CasADi function of (x, y), the same compiled), all in one library."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    functions = {f"unary_{n}": ca.Function(n, [x, y], [f(x)]) for n, (f, _) in UNARY.items()}
    functions |= {f"binary_{n}": ca.Function(n, [x, y], [f(x, y)]) for n, (f, _) in BINARY.items()}
    functions["dead_branch"] = ca.Function("dead", [x, y], [ca.if_else(x > 0, y, 1 / (x - x))])
    functions["constants"] = ca.Function("constants", [x, y], [ca.vertcat(*[ca.SX(c) for c in CONSTANTS])])
    functions["not_finite"] = ca.Function("nf", [x, y], [ca.vertcat(ca.SX(math.inf), -ca.SX.inf(), ca.SX(math.nan))])
    return _compile(functions, tmp_path_factory.mktemp("operations"))


def _compile(functions: dict[str, Any], folder: Path) -> dict[str, tuple[Any, Any]]:
    text = "#include <math.h>\n" + "\n".join(
        emit(f, name, ["x", "y"], ["out"], lambda n: f"/* {n} */") for name, f in functions.items()
    )
    prototypes = "".join(f"void {name}(const double *x, const double *y, double *out);\n" for name in functions)
    (folder / "operations.c").write_text(prototypes + text)
    command = [*find_compiler(), "-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    built = subprocess.run(
        [*command, "-fPIC", "-shared", "operations.c", "-lm", "-o", "operations.so"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    ffi = cffi.FFI()
    ffi.cdef(prototypes)
    library: Any = ffi.dlopen(str(folder / "operations.so"))

    def call(name: str, size: int) -> Any:
        def evaluated(x: float, y: float) -> Array:
            out = ffi.new(f"double[{size}]")
            getattr(library, name)(ffi.new("double[1]", [x]), ffi.new("double[1]", [y]), out)
            return np.array(list(out))

        return evaluated

    return {name: (f, call(name, f.numel_out(0))) for name, f in functions.items()}


def _same(operation: tuple[Any, Any], x: float, y: float) -> None:
    function, compiled = operation
    expected = function(x, y).full().ravel()
    np.testing.assert_allclose(compiled(x, y), expected, rtol=1e-14, atol=0.0, err_msg=f"at {x!r}, {y!r}")


@pytest.mark.parametrize("name", sorted(UNARY))
def test_unary_operation(operations: dict[str, tuple[Any, Any]], name: str) -> None:
    rng = np.random.default_rng(1)
    for value in (*rng.uniform(*UNARY[name][1], 50), *EDGES):
        _same(operations[f"unary_{name}"], float(value), 0.0)


@pytest.mark.parametrize("name", sorted(BINARY))
def test_binary_operation(operations: dict[str, tuple[Any, Any]], name: str) -> None:
    rng = np.random.default_rng(2)
    for x, y in rng.uniform(*BINARY[name][1], (50, 2)):
        _same(operations[f"binary_{name}"], float(x), float(y))
    for x in EDGES:
        for y in EDGES:
            _same(operations[f"binary_{name}"], x, y)


def test_division_by_zero_in_the_dead_branch_does_not_leak(operations: dict[str, tuple[Any, Any]]) -> None:
    function, compiled = operations["dead_branch"]
    assert compiled(2.0, 7.0)[0] == function(2.0, 7.0) == 7.0


def test_constants_read_back_exactly(operations: dict[str, tuple[Any, Any]]) -> None:
    np.testing.assert_array_equal(operations["constants"][1](0.0, 0.0), CONSTANTS)
    np.testing.assert_array_equal(operations["not_finite"][1](0.0, 0.0), [math.inf, -math.inf, math.nan])


@pytest.mark.parametrize("value", [*CONSTANTS, 100.0, 1e16, 0.1])
def test_number_is_a_floating_literal_that_reads_back(value: float) -> None:
    assert float(number(value)) == value
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]\d+)?", number(value))
    assert not re.fullmatch(r"-?\d+", number(value))


def test_matrices_go_column_by_column_and_unused_arguments_compile() -> None:
    x, y = ca.SX.sym("x", 2, 3), ca.SX.sym("y", 2)
    source = emit(ca.Function("f", [x, y], [x.T]), "f", ["x", "y"], ["out"], str)
    assert "out[1] = x[2];" in source
    assert "(void)y;" in source


def test_empty_arguments_are_allowed() -> None:
    x, nothing = ca.SX.sym("x", 2), ca.SX.sym("nothing", 0)
    source = emit(ca.Function("f", [nothing, x], [2 * x, nothing]), "f", ["z", "x"], ["y", "n"], lambda n: "/* f */")
    assert source.startswith("/* f */\nvoid f(const double *z, const double *x, double *y, double *n)\n{\n")
    assert "(void)z;" in source
    assert "(void)n;" in source


def test_mx_function_is_refused() -> None:
    x = ca.MX.sym("x")
    with pytest.raises(CodegenError, match=r"law: only SX functions.*expand"):
        emit(ca.Function("f", [x], [ca.sin(x)]), "law", ["x"], ["y"], str)


def test_sparse_input_and_output_are_refused_by_name() -> None:
    x = ca.SX.sym("x", ca.Sparsity.lower(2))
    with pytest.raises(CodegenError, match="law: input entries is sparse"):
        emit(ca.Function("f", [x], [ca.densify(ca.sum1(x))]), "law", ["entries"], ["y"], str)
    y = ca.SX.sym("y", 2)
    with pytest.raises(CodegenError, match="law: output result is sparse"):
        emit(ca.Function("f", [y], [ca.diag(y)]), "law", ["y"], ["result"], str)


def test_operation_without_c_form_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(CodegenError, match=r"law: CasADi operation \d+ has no C form"):
        emit(ca.Function("f", [x], [ca.erfinv(x)]), "law", ["x"], ["y"], str)
