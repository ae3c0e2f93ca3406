"""CasADi SX functions as C99 for all stages at once: one lane a stage.

The same straight-line body is compiled for vectors of 2, 4 or 8 doubles where the compiler has them (NEON or SSE2,
AVX, AVX-512) and for single doubles elsewhere; operations and their order are the same, so that results agree to
round-off.
Entries of the results that are the same constant in every stage are not computed: `constants` tells which they are,
and the caller writes them once.
"""

import re
from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.codegen.functions import UNARY, number
from aerotact.exceptions import CodegenError

# Operations that vectors have as C operators; all others go through a function of lanes.h.
_OPERATORS = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
}
_SELECTIONS = {
    ca.OP_LT: "lane_lt({}, {})",
    ca.OP_LE: "lane_le({}, {})",
    ca.OP_EQ: "lane_eq({}, {})",
    ca.OP_NE: "lane_ne({}, {})",
    ca.OP_NOT: "lane_not({})",
    ca.OP_AND: "lane_and({}, {})",
    ca.OP_OR: "lane_or({}, {})",
    ca.OP_IF_ELSE_ZERO: "lane_if({}, {})",
    ca.OP_FMIN: "lane_min({}, {})",
    ca.OP_FMAX: "lane_max({}, {})",
    ca.OP_FABS: "lane_abs({})",
    ca.OP_INV: "lane_set(1.0) / {}",
}


_MATH = {text.removesuffix("({})") for text in UNARY.values() if text.endswith("({})") and text[0].isalpha()}


@dataclass(frozen=True)
class Strided:
    """An argument or a result: `stride` doubles from one stage to the next, 0 if all stages share it."""

    name: str
    stride: int


@dataclass(frozen=True)
class StageFunction:
    """A function over all stages, as C.

    Attributes:
        source: the function `void <name>(int stages, const double *..., double *...)`, which fills the entries that
            differ between stages or data.
        signature: its head, without a semicolon.
        constants: result -> {entry: value} of the entries that never change.
        math: functions of math.h that it applies to each lane.
    """

    source: str
    signature: str
    constants: dict[str, dict[int, float]]
    math: tuple[str, ...]


def emit_stages(function: Any, name: str, inputs: list[Strided], outputs: list[Strided]) -> StageFunction:
    """C of a dense SX function, called for stages 0, 1, ... in groups of LANES.

    Raises:
        CodegenError: no SX function, or an operation that C lacks.
    """
    if not function.is_a("SXFunction"):
        raise CodegenError(f"{name}: only SX functions can be written as C; expand() it first")
    body: list[str] = []
    version: dict[int, str] = {}
    constant: dict[int, float] = {}
    constants: dict[str, dict[int, float]] = {o.name: {} for o in outputs}
    loaded: dict[tuple[int, int], str] = {}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        args, results = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            target = outputs[results[0]]
            if args[0] in constant:
                constants[target.name][results[1]] = constant[args[0]]
            else:
                body.append(f"lane_store({target.name} + {results[1]}, {target.stride}, k, count, {version[args[0]]});")
            continue
        constant.pop(results[0], None)
        if op == ca.OP_CONST:
            constant[results[0]] = function.instruction_constant(k)
            version[results[0]] = f"lane_set({number(constant[results[0]])})"
            continue
        if op == ca.OP_INPUT:
            key = (args[0], args[1])
            if key not in loaded:
                source = inputs[args[0]]
                loaded[key] = f"{source.name}_{args[1]}"
                read = (
                    f"lane_load({source.name} + {args[1]}, {source.stride}, k, count)"
                    if source.stride
                    else f"lane_set({source.name}[{args[1]}])"
                )
                body.append(f"const lane {loaded[key]} = {read};")
            version[results[0]] = loaded[key]
            continue
        body.append(f"const lane v{k} = {_value(name, op, [version[a] for a in args])};")
        version[results[0]] = f"v{k}"
    parameters = [f"const double *{i.name}" for i in inputs] + [f"double *{o.name}" for o in outputs]
    head = f"void {name}(int stages, {', '.join(parameters)})"
    used = {i.name for n, i in enumerate(inputs) if any(key[0] == n for key in loaded)}
    used |= {o.name for o in outputs if any(line.startswith(f"lane_store({o.name} ") for line in body)}
    unused = [f"    (void){p.name};" for p in (*inputs, *outputs) if p.name not in used]
    source = "\n".join(
        [
            head,
            "{",
            "    int k;",
            *unused,
            "    for (k = 0; k < stages; k += LANES) {",
            "        const int count = stages - k < LANES ? stages - k : LANES;",
            *[f"        {line}" for line in body],
            "    }",
            "}",
            "",
        ]
    )
    math = sorted(set(re.findall(r"lane_(\w+)\(", source)) & _MATH)
    return StageFunction(source, head, constants, tuple(math))


def _value(name: str, op: int, arguments: list[str]) -> str:
    """Expression of one operation on lanes."""
    if op in _OPERATORS:
        return _OPERATORS[op].format(*arguments)
    if op in _SELECTIONS:
        return _SELECTIONS[op].format(*arguments)
    if op in UNARY and UNARY[op].endswith("({})"):
        return f"lane_{UNARY[op].format(arguments[0])}"
    raise CodegenError(f"{name}: CasADi operation {op} has no C form for lanes")
