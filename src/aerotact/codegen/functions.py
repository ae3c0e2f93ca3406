"""CasADi SX functions as C99: one straight-line C function each, no memory, no state, nothing but math.h.

Every CasADi instruction becomes one assignment to a numbered local, in CasADi's own order, so that the compiled
function equals CasADi's evaluation to round-off.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca

from aerotact.exceptions import CodegenError

BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_POW: "pow({}, {})",
    ca.OP_CONSTPOW: "pow({}, {})",
    ca.OP_LT: "({} < {}) ? 1.0 : 0.0",
    ca.OP_LE: "({} <= {}) ? 1.0 : 0.0",
    ca.OP_EQ: "({} == {}) ? 1.0 : 0.0",
    ca.OP_NE: "({} != {}) ? 1.0 : 0.0",
    ca.OP_AND: "({} != 0.0 && {} != 0.0) ? 1.0 : 0.0",
    ca.OP_OR: "({} != 0.0 || {} != 0.0) ? 1.0 : 0.0",
    ca.OP_IF_ELSE_ZERO: "({} != 0.0) ? {} : 0.0",
    ca.OP_FMIN: "fmin({}, {})",
    ca.OP_FMAX: "fmax({}, {})",
    ca.OP_FMOD: "fmod({}, {})",
    ca.OP_REMAINDER: "remainder({}, {})",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_COPYSIGN: "copysign({}, {})",
    ca.OP_HYPOT: "hypot({}, {})",
}
UNARY = {
    ca.OP_ASSIGN: "{}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_NOT: "({} == 0.0) ? 1.0 : 0.0",
    ca.OP_SIGN: "({0} > 0.0) ? 1.0 : (({0} < 0.0) ? -1.0 : {0})",
    **{
        getattr(ca, f"OP_{name.upper()}"): name + "({})"
        for name in [
            "exp",
            "log",
            "sqrt",
            "sin",
            "cos",
            "tan",
            "asin",
            "acos",
            "atan",
            "sinh",
            "cosh",
            "tanh",
            "asinh",
            "acosh",
            "atanh",
            "floor",
            "ceil",
            "fabs",
            "log1p",
            "expm1",
            "erf",
        ]
    },
}


def number(value: float) -> str:
    """A double as a C literal that reads back exactly."""
    text = f"{value:.17g}"
    if text in ("inf", "-inf"):
        return text.replace("inf", "HUGE_VAL")
    if text == "nan":
        return "NAN"
    return text if any(c in text for c in ".en") else text + ".0"


def emit(function: Any, name: str, arguments: list[str], results: list[str], describe: Callable[[str], str]) -> str:
    """C source of an SX function whose inputs and outputs are dense vectors or matrices (column by column).

    Args:
        function: a casadi.Function made of SX.
        name: the C function's name.
        arguments: names of the `const double *` parameters.
        results: names of the `double *` parameters; every entry is written.
        describe: comment line for the function, given its name.

    Raises:
        CodegenError: the function is no SX function, is not dense, or holds an operation that C lacks.
    """
    if not function.is_a("SXFunction"):
        raise CodegenError(f"{name}: only SX functions can be written as C; expand() it first")
    for i in range(function.n_in()):
        if not function.sparsity_in(i).is_dense() and function.nnz_in(i):
            raise CodegenError(f"{name}: input {arguments[i]} is sparse; densify it first")
    for i in range(function.n_out()):
        if not function.sparsity_out(i).is_dense():
            raise CodegenError(f"{name}: output {results[i]} is sparse; densify it first")
    lines: list[str] = []
    version: dict[int, str] = {}
    used: set[str] = set()
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            used.add(results[outputs[0]])
            lines.append(f"    {results[outputs[0]]}[{outputs[1]}] = {version[inputs[0]]};")
            continue
        if op == ca.OP_CONST:
            version[outputs[0]] = number(function.instruction_constant(k))
            if version[outputs[0]].startswith("-"):
                version[outputs[0]] = f"({version[outputs[0]]})"
            continue
        if op == ca.OP_INPUT:
            used.add(arguments[inputs[0]])
            version[outputs[0]] = f"{arguments[inputs[0]]}[{inputs[1]}]"
            continue
        if op in BINARY:
            value = BINARY[op].format(version[inputs[0]], version[inputs[1]])
        elif op in UNARY:
            value = UNARY[op].format(version[inputs[0]])
        else:
            raise CodegenError(f"{name}: CasADi operation {op} has no C form here")
        version[outputs[0]] = f"v{k}"
        lines.append(f"    const double v{k} = {value};")
    unused = [f"    (void){a};" for a in (*arguments, *results) if a not in used]
    return "\n".join([describe(name), signature(name, arguments, results), "{", *unused, *lines, "}", ""])


def signature(name: str, arguments: list[str], results: list[str]) -> str:
    """The C function's head, without a semicolon."""
    parameters = [f"const double *{a}" for a in arguments] + [f"double *{r}" for r in results]
    return f"void {name}({', '.join(parameters)})"
