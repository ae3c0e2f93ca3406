"""Back ends: who solves the quadratic programme. Each gives C files with the interface of templates/qp/qp.h.jinja."""

from collections.abc import Callable
from dataclasses import dataclass

import jinja2

from aerotact.exceptions import UnknownName


@dataclass(frozen=True)
class QpDimensions:
    """Dimensions of an OCP QP: states, controls, intervals, and the indices of the bounded states."""

    nx: int
    nu: int
    steps: int
    bounded: tuple[int, ...]


Backend = Callable[[str, QpDimensions], dict[str, str]]
"""(prefix, dimensions) -> path inside the project -> text."""


def _interior_point(prefix: str, dimensions: QpDimensions) -> dict[str, str]:
    """Structured primal-dual interior point method on a Riccati recursion."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("aerotact.codegen"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    context = {
        "prefix": prefix,
        "nx": dimensions.nx,
        "nu": dimensions.nu,
        "N": dimensions.steps,
        "idxbx": list(dimensions.bounded),
        "ng": 0,
        "soft_x": [False] * len(dimensions.bounded),
        "soft_g": [],
    }
    return {
        f"include/{prefix}_qp.h": environment.get_template("qp/qp.h.jinja").render(context),
        f"src/{prefix}_qp.c": environment.get_template("qp/qp.c.jinja").render(context),
    }


BACKENDS: dict[str, Backend] = {"aerotact": _interior_point}


def find_backend(name: str, where: str) -> Backend:
    """A back end by name.

    Raises:
        UnknownName: there is none of that name.
    """
    if name not in BACKENDS:
        raise UnknownName("solver back end", name, BACKENDS, where)
    return BACKENDS[name]
