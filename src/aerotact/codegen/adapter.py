"""Adapter: what the templates of every foreign solver of OCP QPs share; their common parts are `templates/adapter`."""

from typing import Any

from aerotact.codegen.qp_structure import QpPattern
from aerotact.exceptions import CodegenError


def adapter_context(prefix: str, pattern: QpPattern, solver: str) -> dict[str, Any]:
    """What those templates know, for C names that begin with `prefix`; `solver` is its name in comments."""
    return {
        "prefix": prefix,
        "solver": solver,
        "nx": pattern.nx,
        "nu": pattern.nu,
        "N": pattern.steps,
        "bounded": list(pattern.bounded),
        "ng": pattern.general,
        "soft_x": list(pattern.soft_bounds) or [False] * len(pattern.bounded),
        "soft_g": list(pattern.soft_rows) or [False] * pattern.general,
    }


def refuse_single(prefix: str, pattern: QpPattern, backend: str) -> None:
    """These solvers are called with doubles.

    Raises:
        CodegenError: the pattern wants floats.
    """
    if pattern.single:
        raise CodegenError(
            f"{prefix}: the back end {backend} knows doubles only; valid in single precision: the back end aerotact"
        )
