"""Adapter: what the templates of every foreign solver of OCP QPs share; their common parts are `templates/adapter`."""

from typing import Any

from aerotact.codegen.qp_structure import QpPattern


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
