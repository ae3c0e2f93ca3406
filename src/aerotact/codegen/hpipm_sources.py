"""HPIPM as a back end: the adapter that gives it the common interface; HPIPM and BLASFEO are linked."""

from aerotact.codegen.adapter import adapter_context, refuse_single
from aerotact.codegen.functions import number
from aerotact.codegen.qp_structure import ONE, QpPattern
from aerotact.codegen.templating import templates

TOLERANCE = 1e-8
FAST = 25  # iterations before the careful mode starts anew
MAX_ITERATIONS = 100
CHUNK = 5  # iterations between two looks at the clock
_PANEL = 8  # largest panel of BLASFEO's targets, doubles
_LINE = 64  # bytes of a cache line
_STRUCT = 64  # bytes, no fewer than a matrix or vector struct of BLASFEO has
_STATISTICS = 20  # doubles that HPIPM keeps of an iteration


def hpipm_sources(prefix: str, pattern: QpPattern) -> dict[str, str]:
    """Adapter: path inside the project -> text.

    Raises:
        CodegenError: single precision.
    """
    refuse_single(prefix, pattern, "hpipm")
    masks = [] if pattern.direct else _masks(pattern)
    context = {
        **adapter_context(prefix, pattern, "HPIPM"),
        "chunk": CHUNK,
        "fast": FAST,
        "tolerance": number(TOLERANCE),
        "max_iterations": MAX_ITERATIONS,
        "bytes": workspace_bound(pattern),
        "masks": masks,
        "masked": bool(masks),
    }
    environment = templates()
    return {
        f"include/{prefix}_qp.h": environment.get_template("hpipm/qp.h.jinja").render(context),
        f"src/{prefix}_qp.c": environment.get_template("hpipm/qp.c.jinja").render(context),
    }


def _masks(pattern: QpPattern) -> list[tuple[str, list[int], list[int]]]:
    """Of each matrix that has some: (name, places of entries that are always zero, always one)."""
    found = []
    for name in ("A", "B", "Q", "S", "R"):
        grid = getattr(pattern, name)
        if grid is None:
            continue
        symmetric = name in ("Q", "R")
        free = [[bool(v) or (symmetric and bool(grid[j][i])) for j, v in enumerate(row)] for i, row in enumerate(grid)]
        width = len(grid[0])
        zeros = [i * width + j for i, row in enumerate(free) for j, v in enumerate(row) if not v]
        ones = [i * width + i for i in range(len(grid)) if name == "A" and grid[i][i] == ONE]
        if zeros or ones:
            found.append((name, zeros, ones))
    return found


def _up(value: int, step: int) -> int:
    return -(-value // step) * step


def _matrix(rows: int, columns: int) -> int:
    """Bytes of a BLASFEO matrix, panels padded, and of the inverse diagonal beside it."""
    elements = _up(rows, _PANEL) * _up(columns, _PANEL) + _up(min(rows, columns), _PANEL**2)
    return _up(8 * elements, _LINE)


def _vector(size: int) -> int:
    return _up(8 * _up(size, _PANEL), _LINE)


def workspace_bound(pattern: QpPattern) -> int:
    """Bytes that HPIPM asks for at most: the sum of its *_memsize for the widest panels, from sizes alone.

    The C checks what the installed HPIPM asks for against it.
    """
    N, nx, nu, ng = pattern.steps, pattern.nx, pattern.nu, pattern.general
    nb, ns = len(pattern.bounded), sum(pattern.soft_bounds) + sum(pattern.soft_rows)
    n, rows = nx + nu, nu + nb + ng
    variables, constraints = (N + 1) * (n + 2 * ns), (N + 1) * 2 * (rows + ns)
    stage = {
        "matrices": 3 * _matrix(n + 1, n) + _matrix(n + 1, nx) + _matrix(n, ng),  # RSQrq, L and Lh, BAbt, DCt
        "vectors": _vector(nx) + 3 * _vector(2 * ns) + _vector(n),  # Pb, Z and Zs_inv, l
        "indices": 4 * (40 + 3 * rows) + 3 * 8,
        "structs": 40 * _STRUCT,
    }
    whole = {
        "problem": _vector(variables) + _vector(N * nx) + 3 * _vector(constraints),
        "solutions": 2 * (_vector(variables) + _vector(N * nx) + 2 * _vector(constraints)),
        "residuals": _vector(variables) + _vector(N * nx) + 2 * _vector(constraints),
        "core": 8 * (3 * variables + 3 * N * nx + 11 * constraints),
        "work": 2 * _matrix(nx, nx) + _matrix(nx + 1, nu) + 2 * _matrix(n + 1, nx + ng) + _vector(constraints),
        "triangular": 3 * _matrix(n, 2 * nu + 3 * nx + ng),  # lq0, and the work space of its factorisation
        "rows": 8 * _vector(rows) + _vector(n),
        "statistics": 8 * _STATISTICS * (1 + MAX_ITERATIONS),
        "structs": 64 * _STRUCT + 4096,
    }
    return _up((N + 1) * sum(stage.values()) + sum(whole.values()), _LINE)
