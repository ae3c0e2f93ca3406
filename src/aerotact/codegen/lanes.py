"""CasADi SX functions as C99 for all stages at once: one lane a stage.

The same straight-line body is compiled for vectors of 2, 4 or 8 doubles where the compiler has them (NEON or SSE2,
AVX, AVX-512) and for single doubles elsewhere; operations and their order are the same, so that results agree to
round-off. A product that only one sum takes is fused with it where the processor can. Code for many stages costs more
to fetch than to run, and to compile more than in proportion to its length: the body is cut into parts of bounded
length, and what one part hands to the next is kept beside inputs and results in an array of lanes.
Entries of the results that are the same constant in every stage are not computed: `constant_entries` tells which they
are, and the caller writes them once.
"""

import heapq
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.codegen.functions import UNARY, number
from aerotact.exceptions import CodegenError

_PART = 800  # operations

# Operations that vectors have as C operators; all others go through a function of lanes.h.
_OPERATORS = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}",
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


Place = tuple[str, int]
"""C expression of an array of doubles in stage `k`, and an index in it."""


@dataclass(frozen=True)
class StageFunction:
    """A function over all stages, as C.

    Attributes:
        source: the function, and what it calls.
        signature: its head, without a semicolon.
        math: functions of math.h that it applies to each lane.
    """

    source: str
    signature: str
    math: tuple[str, ...]


@dataclass(frozen=True)
class _Operation:
    """One instruction; arguments are numbers of operations."""

    op: int
    arguments: tuple[int, ...]


class _Program:
    """A function's instructions in single assignment.

    Attributes:
        operations: number -> operation, in an order in which they can be computed.
        constants: number -> value; inputs: number -> (argument, entry); outputs: (result, entry, number).
    """

    def __init__(self, function: Any) -> None:
        self.operations: dict[int, _Operation] = {}
        self.constants: dict[int, float] = {}
        self.inputs: dict[int, tuple[int, int]] = {}
        self.outputs: list[tuple[int, int, int]] = []
        register: dict[int, int] = {}
        loaded: dict[tuple[int, ...], int] = {}
        for k in range(function.n_instructions()):
            op, taken, given = (getattr(function, f"instruction_{part}")(k) for part in ("id", "input", "output"))
            if op == ca.OP_OUTPUT:
                self.outputs.append((given[0], given[1], register[taken[0]]))
                continue
            arguments = tuple(register[t] for t in taken) if op != ca.OP_INPUT else ()
            register[given[0]] = k
            if op == ca.OP_CONST:
                self.constants[k] = function.instruction_constant(k)
            elif op == ca.OP_INPUT:
                register[given[0]] = loaded.setdefault(tuple(taken), k)
                self.inputs[loaded[tuple(taken)]] = (taken[0], taken[1])
            else:
                self.operations[k] = self._simpler(k, op, arguments)
        self._fuse()

    def _simpler(self, k: int, op: int, arguments: tuple[int, ...]) -> _Operation:
        """Squares as products, and division by a constant as a product with its inverse."""
        if op == ca.OP_SQ:
            return _Operation(ca.OP_MUL, arguments * 2)
        if op == ca.OP_DIV and self.constants.get(arguments[1]):
            self.constants[-k] = 1.0 / self.constants[arguments[1]]
            return _Operation(ca.OP_MUL, (arguments[0], -k))
        return _Operation(op, arguments)

    def _fuse(self) -> None:
        """Find the sums that take a product of their own."""
        self.fused: dict[int, int] = {}
        uses = Counter(a for operation in self.operations.values() for a in operation.arguments)
        uses.update(k for _, _, k in self.outputs)
        for k, operation in self.operations.items():
            if operation.op not in (ca.OP_ADD, ca.OP_SUB):
                continue
            for place in (1, 0):
                factor = operation.arguments[place]
                product = self.operations.get(factor)
                if product is not None and product.op == ca.OP_MUL and uses[factor] == 1:
                    self.fused[k] = place
                    break
        absorbed = {self.operations[k].arguments[place] for k, place in self.fused.items()}
        self.order = [k for k in self.operations if k not in absorbed]

    def taken(self, k: int) -> list[int]:
        """What the computation of k reads."""
        arguments = list(self.operations[k].arguments)
        if k in self.fused:
            place = self.fused[k]
            arguments[place : place + 1] = self.operations[arguments[place]].arguments
        return arguments


class _Parts:
    """How a program is cut, and where its numbers are kept.

    Attributes:
        parts: operations by part.
        slots: number -> index in the array of lanes, of inputs, results and what crosses from part to part.
        size: lanes in the array.
    """

    def __init__(self, program: _Program) -> None:
        order = program.order
        count = max(1, -(-len(order) // _PART))
        self.parts = [order[len(order) * i // count : len(order) * (i + 1) // count] for i in range(count)]
        made = {k: i for i, part in enumerate(self.parts) for k in part}
        last: dict[int, int] = {}
        for i, part in enumerate(self.parts):
            for k in part:
                last.update((a, i) for a in program.taken(k) if made.get(a, i) < i)
        results = {k for _, _, k in program.outputs if k not in program.constants}
        self.slots = {k: i for i, k in enumerate(program.inputs)}
        self.size = len(self.slots)
        free: list[int] = []
        expiring: list[tuple[int, int]] = []
        for i, part in enumerate(self.parts):
            while expiring and expiring[0][0] < i:
                heapq.heappush(free, heapq.heappop(expiring)[1])
            for k in part:
                if k not in results and k not in last:
                    continue
                if free:
                    self.slots[k] = heapq.heappop(free)
                else:
                    self.slots[k], self.size = self.size, self.size + 1
                if k not in results:
                    heapq.heappush(expiring, (last[k], self.slots[k]))


def constant_entries(function: Any) -> list[dict[int, float]]:
    """Of each result of a dense SX function, the entries that are constants: index -> value."""
    program = _Program(function)
    found: list[dict[int, float]] = [{} for _ in range(function.n_out())]
    for result, entry, k in program.outputs:
        if k in program.constants:
            found[result][entry] = program.constants[k]
    return found


def emit_stages(
    function: Any,
    name: str,
    parameters: str,
    stages: str,
    inputs: Sequence[str],
    places: Callable[[int, int], Sequence[Place]],
) -> StageFunction:
    """C of a dense SX function, called for stages 0, 1, ... in groups of LANES.

    Args:
        function: of SX, with dense inputs and outputs.
        name: of the C function.
        parameters: of the C function.
        stages: C expression of their number.
        inputs: for each argument the C expression of its numbers in stage `k`, in terms of the parameters.
        places: (result, entry) -> where it is wanted. Constants are written nowhere.

    Raises:
        CodegenError: no SX function, or an operation that C lacks.
    """
    if not function.is_a("SXFunction"):
        raise CodegenError(f"{name}: only SX functions can be written as C; expand() it first")
    program = _Program(function)
    cut = _Parts(program)
    arrays: dict[str, str] = {}
    stores = []
    for result, entry, k in program.outputs:
        wanted = places(result, entry)
        if k not in program.constants and wanted:
            targets = [f"{arrays.setdefault(array, f'to{len(arrays)}')}[{index}]" for array, index in wanted]
            stores.append(f"{' = '.join(targets)} = LANE_OF(w[{cut.slots[k]}], l);")
    loads = [
        f"LANE_OF(w[{cut.slots[k]}], l) = from{argument}[{entry}];" for k, (argument, entry) in program.inputs.items()
    ]
    taken = {argument for argument, _ in program.inputs.values()}
    head = f"void {name}({parameters})"
    lines = [
        "    for (first = 0; first < stages; first += LANES) {",
        "        for (l = 0; l < LANES; ++l) {",
        "            const int k = first + l < stages ? first + l : stages - 1;",
        *[f"            const double *const from{i} = {array};" for i, array in enumerate(inputs)],
        *[f"            (void)from{i};" for i in range(len(inputs)) if i not in taken],
        *[f"            {line}" for line in loads],
        "        }",
        *[f"        {name}_part{i}(w);" for i in range(len(cut.parts))],
        "        for (l = 0; l < LANES && first + l < stages; ++l) {",
        "            const int k = first + l;",
        *[f"            double *const {pointer} = {array};" for array, pointer in arrays.items()],
        *[f"            {line}" for line in stores],
        "        }",
        "    }",
    ]
    frame = [
        "{",
        f"    const int stages = {stages};",
        f"    lane w[{max(cut.size, 1)}];",
        "    int first, l;",
        *lines,
        "}",
        "",
    ]
    parts = [_part(name, i, part, program, cut) for i, part in enumerate(cut.parts)]
    source = "\n".join([*parts, head, *frame])
    math = sorted(set(re.findall(r"lane_(\w+)\(", source)) & _MATH)
    return StageFunction(source, head, tuple(math))


def _part(name: str, index: int, part: list[int], program: _Program, cut: _Parts) -> str:
    """C of one part."""
    known: dict[int, str] = {}
    lines: list[str] = []

    def read(k: int) -> str:
        if k in program.constants:
            return f"lane_set({number(program.constants[k])})"
        if k not in known:
            known[k] = f"c{cut.slots[k]}"
            lines.append(f"const lane {known[k]} = w[{cut.slots[k]}];")
        return known[k]

    for k in part:
        arguments = [read(a) for a in program.taken(k)]
        value = _value(name, program.operations[k].op, arguments, program.fused.get(k))
        known[k] = f"v{k}"
        lines.append(f"const lane v{k} = {value};")
        if k in cut.slots:
            lines.append(f"w[{cut.slots[k]}] = v{k};")
    return "\n".join([f"static NOINLINE void {name}_part{index}(lane *w)", "{", *[f"    {s}" for s in lines], "}", ""])


def _value(name: str, op: int, arguments: list[str], fused: int | None) -> str:
    """Expression of one operation on lanes; `fused` is the place of a product in a sum."""
    if fused is not None:
        if fused == 0:
            a, b, c = arguments
            return f"lane_fma({a}, {b}, {c if op == ca.OP_ADD else f'-{c}'})"
        c, a, b = arguments
        return f"lane_fma({a if op == ca.OP_ADD else f'-{a}'}, {b}, {c})"
    if op in _OPERATORS:
        return _OPERATORS[op].format(*arguments)
    if op in _SELECTIONS:
        return _SELECTIONS[op].format(*arguments)
    if op in UNARY and UNARY[op].endswith("({})"):
        return f"lane_{UNARY[op].format(arguments[0])}"
    raise CodegenError(f"{name}: CasADi operation {op} has no C form for lanes")
