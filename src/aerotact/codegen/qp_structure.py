"""Sparsity of an OCP QP -> how the solver lays a stage out: what the templates in `templates/qp` need to know.

A stage's unknowns are z = [controls | states], permuted and padded with zeros to whole vector registers. A row of [B A]
is *trivial* if its A part is empty or exactly the identity's and its B part has at most one entry, in a control that no
other trivial row uses: integrators, delays, constants. Trivial states come first, in the order of their controls, so
that products with their rows are shifted copies; the other, *dense* states follow, those with the fullest columns
first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

ZERO, FREE, ONE = 0, 1, 2
Pattern = Sequence[Sequence[int]]
"""Rows of ZERO (always zero, not read), FREE (data), ONE (always one; counts on A's diagonal only)."""

_REGISTER = 8  # doubles that arrays are padded to
_BLOCK = 4  # rows or columns that a kernel takes at once


@dataclass(frozen=True)
class QpPattern:
    """Dimensions and sparsity of an OCP QP, the same in all stages.

    Attributes:
        nx, nu, steps: states, controls, intervals.
        bounded: indices of the bounded states.
        general: number of general rows.
        soft_bounds, soft_rows: which bounded states and which general rows are soft.
        A, B, Q, R, S: patterns; all FREE if None.
        direct: the caller keeps A, B, b, Q, S, R, q and r in the solver's own arrays, at its back end's places, and
            not in the data.
        single: floats instead of doubles.
    """

    nx: int
    nu: int
    steps: int
    bounded: tuple[int, ...] = ()
    general: int = 0
    soft_bounds: tuple[bool, ...] = ()
    soft_rows: tuple[bool, ...] = ()
    A: Pattern | None = field(default=None, repr=False)
    B: Pattern | None = field(default=None, repr=False)
    Q: Pattern | None = field(default=None, repr=False)
    R: Pattern | None = field(default=None, repr=False)
    S: Pattern | None = field(default=None, repr=False)
    direct: bool = False
    single: bool = False


@dataclass(frozen=True)
class _Order:
    """Internal order: `u` and `x` list controls and states; the first `trivial` states are trivial, the rest dense."""

    u: list[int]
    x: list[int]
    trivial: int
    integrators: list[tuple[int, int]]

    @property
    def dense(self) -> list[int]:
        return self.x[self.trivial :]


def template_context(prefix: str, pattern: QpPattern) -> dict[str, Any]:
    """What the templates of the solver need, for C names that begin with `prefix`."""
    nx, nu = pattern.nx, pattern.nu
    A, B = _grid(pattern.A, nx, nx), _grid(pattern.B, nx, nu)
    Q, R, S = _symmetric(_grid(pattern.Q, nx, nx)), _symmetric(_grid(pattern.R, nu, nu)), _grid(pattern.S, nu, nx)
    order = _order(A, B, pattern.bounded)
    place = {state: position for position, state in enumerate(order.x)}
    rows = _rows(A, B, order)
    filled = [{column for column, _, _ in row} for row in rows]
    hessian = _hessian(Q, R, S, order)
    bounded = [nu + place[i] for i in pattern.bounded]
    dense = len(order.dense)
    return {
        "prefix": prefix,
        "nx": nx,
        "nu": nu,
        "N": pattern.steps,
        "idxbx": list(pattern.bounded),
        "ng": pattern.general,
        "soft_x": list(pattern.soft_bounds) or [False] * len(pattern.bounded),
        "soft_g": list(pattern.soft_rows) or [False] * pattern.general,
        "n": nu + nx,
        "ld": _padded(nu + nx),
        "lu": _padded(nu),
        "ldd": _padded(max(dense, 1)),
        "nt": order.trivial,
        "nd": dense,
        "nint": len(order.integrators),
        "u_order": order.u,
        "x_order": order.x,
        "bound_cols": bounded,
        "lb": _padded(max([*range(nu), *bounded]) + 1),
        "keep": [1 if A[i][i] else 0 for i in order.x[: order.trivial]],
        "gain": [(position, i * nu + j) for position, (i, j) in enumerate(order.integrators)],
        "rows": rows,
        "entries": [(number, *entry) for number, row in enumerate(rows) for entry in row],
        "direct": pattern.direct,
        "single": pattern.single,
        "tolerance": "0.00001" if pattern.single else "1e-8",
        "tolerance_feasibility": "0.000001" if pattern.single else "1e-8",
        "kappa": "1000.0" if pattern.single else "1e5",
        "hess": hessian,
        "hess_q": [entry for entry in hessian if entry[2] == "Q"],
        "blocks_w": [{"i": i, "m": min(_BLOCK, nx - i)} for i in range(0, nx, _BLOCK)],
        "blocks_u": _blocks(filled, 0, nu),
        "blocks_x": _blocks(filled, nu, nu + nx),
    }


Places = dict[tuple[str, int], list[tuple[str, int]]]
"""(matrix or vector of the data, entry) -> where it is kept: (array of a stage, index) of each copy."""


def workspace_places(pattern: QpPattern) -> Places:
    """Where the workspace keeps one stage of the data; entries that it does not read are missing."""
    context = template_context("", pattern)
    nu, ld = pattern.nu, context["ld"]
    places: Places = {}
    for row, column, name, entry in context["entries"]:
        places[name, entry] = [("G", row * ld + column)]
    for position, entry in context["gain"]:
        places["B", entry] = [("gain", position)]
    for position, (_, _, name, entry) in enumerate(context["hess"]):
        places[name, entry] = [("hv", position)]
    for position, entry in enumerate(context["u_order"]):
        places["r", entry] = [("q", position)]
    for position, entry in enumerate(context["x_order"]):
        places["q", entry], places["b", entry] = [("q", nu + position)], [("c", nu + position)]
    return places


def _padded(count: int) -> int:
    return max(_REGISTER, -(-count // _REGISTER) * _REGISTER)


def _grid(pattern: Pattern | None, rows: int, columns: int) -> list[list[int]]:
    return [[FREE] * columns for _ in range(rows)] if pattern is None else [[int(v) for v in row] for row in pattern]


def _symmetric(pattern: list[list[int]]) -> list[list[int]]:
    size = range(len(pattern))
    return [[1 if pattern[i][j] or pattern[j][i] else 0 for j in size] for i in size]


def _order(A: list[list[int]], B: list[list[int]], bounded: Iterable[int]) -> _Order:
    integrators: list[tuple[int, int]] = []
    constants: list[int] = []
    used: set[int] = set()
    for i, (a_row, b_row) in enumerate(zip(A, B, strict=True)):
        a = [j for j, entry in enumerate(a_row) if entry]
        b = [j for j, entry in enumerate(b_row) if entry]
        if a and not (a == [i] and a_row[i] == ONE):
            continue
        if not b:
            constants.append(i)
        elif len(b) == 1 and b[0] not in used:
            integrators.append((i, b[0]))
            used.add(b[0])
    integrators.sort(key=lambda pair: pair[1])
    trivial = [i for i, _ in integrators] + constants
    dense = [i for i in range(len(A)) if i not in trivial]
    limited = set(bounded)
    full = {i: sum(1 for r in dense if A[r][i]) for i in dense}
    dense.sort(key=lambda i: (-full[i], i not in limited, i))
    free = [j for j in range(len(B[0])) if j not in used]
    return _Order([j for _, j in integrators] + free, trivial + dense, len(trivial), integrators)


def _rows(A: list[list[int]], B: list[list[int]], order: _Order) -> list[list[tuple[int, str, int]]]:
    """Of each dense row of [B A]: (internal column, array, index in it) of what is not zero."""
    nx, nu = len(order.x), len(order.u)
    return [
        [(c, "B", i * nu + j) for c, j in enumerate(order.u) if B[i][j]]
        + [(nu + c, "A", i * nx + j) for c, j in enumerate(order.x) if A[i][j]]
        for i in order.dense
    ]


def _hessian(
    Q: list[list[int]], R: list[list[int]], S: list[list[int]], order: _Order
) -> list[tuple[int, int, str, int]]:
    """Upper triangle of a stage's Hessian: (internal row, internal column, array, index in it)."""
    nx, nu = len(order.x), len(order.u)
    entries: list[tuple[int, int, str, int]] = []
    for i, ui in enumerate(order.u):
        entries += [(i, j, "R", ui * nu + uj) for j, uj in enumerate(order.u) if j >= i and R[ui][uj]]
        entries += [(i, nu + j, "S", ui * nx + xj) for j, xj in enumerate(order.x) if S[ui][xj]]
    for i, xi in enumerate(order.x):
        entries += [(nu + i, nu + j, "Q", xi * nx + xj) for j, xj in enumerate(order.x) if j >= i and Q[xi][xj]]
    return entries


def _blocks(filled: list[set[int]], first: int, last: int) -> list[dict[str, int]]:
    """Columns first..last in blocks, each with the range of dense rows that holds all of its entries."""
    blocks = []
    for i in range(first, last, _BLOCK):
        width = min(_BLOCK, last - i)
        hit = [row for row, columns in enumerate(filled) if columns & set(range(i, i + width))]
        low, high = (min(hit), max(hit) + 1) if hit else (0, 0)
        blocks.append({"i": i, "m": width, "lo": low, "k": high - low})
    return blocks
