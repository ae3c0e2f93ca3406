"""Back ends: who solves the quadratic programme. Each gives C files with the interface of templates/qp/qp.h.jinja."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import jinja2

from aerotact.exceptions import UnknownName


@dataclass(frozen=True)
class QpDimensions:
    """Dimensions of an OCP QP.

    Attributes:
        nx, nu, steps: states, controls, intervals.
        bounded: indices of the bounded states.
        general: rows lg <= C x + D u <= ug of every stage.
        zeros: of A, B, Q, S, R (stages before the last) and Q_end, row by row, the entries that are zero for all data;
            a matrix that is not named is dense.
    """

    nx: int
    nu: int
    steps: int
    bounded: tuple[int, ...]
    general: int = 0
    zeros: Mapping[str, frozenset[int]] = field(default_factory=dict)


Sources = Callable[[str, QpDimensions], dict[str, str]]
"""(prefix, dimensions) -> path inside the project -> text; what others wrote goes below third_party/."""


@dataclass(frozen=True)
class Backend:
    """A back end.

    Attributes:
        sources: its C files.
        caveat: what its users must know, one sentence for header, README and manifest; empty if there is nothing.
    """

    sources: Sources
    caveat: str = ""


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
        "ng": dimensions.general,
        "soft_x": [False] * len(dimensions.bounded),
        "soft_g": [False] * dimensions.general,
    }
    return {
        f"include/{prefix}_qp.h": environment.get_template("qp/qp.h.jinja").render(context),
        f"src/{prefix}_qp.c": environment.get_template("qp/qp.c.jinja").render(context),
    }


def _osqp(prefix: str, dimensions: QpDimensions) -> dict[str, str]:
    """OSQP's embedded code; imported only when it is wanted."""
    from aerotact.codegen.osqp_sources import osqp_sources  # noqa: PLC0415

    return osqp_sources(prefix, dimensions)


BACKENDS: dict[str, Backend] = {
    "aerotact": Backend(_interior_point),
    "osqp": Backend(
        _osqp, "OSQP's work arrays are variables of this library: steps must not overlap, whatever their workspace."
    ),
}


def find_backend(name: str, where: str) -> Backend:
    """A back end by name.

    Raises:
        UnknownName: there is none of that name.
    """
    if name not in BACKENDS:
        raise UnknownName("solver back end", name, BACKENDS, where)
    return BACKENDS[name]
