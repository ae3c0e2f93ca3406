"""Back ends: who solves the quadratic programme. Each gives C files with the interface of templates/qp/qp.h.jinja."""

from collections.abc import Callable

import jinja2

from aerotact.codegen.qp_structure import QpPattern, template_context
from aerotact.exceptions import UnknownName

Backend = Callable[[str, QpPattern], dict[str, str]]
"""(prefix, pattern) -> path inside the project -> text."""


def aerotact_qp(prefix: str, pattern: QpPattern) -> dict[str, str]:
    """Warm-started active set with an interior-point fallback on a structured Riccati recursion."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("aerotact.codegen"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    context = template_context(prefix, pattern)
    return {
        f"include/{prefix}_qp.h": environment.get_template("qp/qp.h.jinja").render(context),
        f"src/{prefix}_qp.c": environment.get_template("qp/qp.c.jinja").render(context),
    }


BACKENDS: dict[str, Backend] = {"aerotact": aerotact_qp}


def find_backend(name: str, where: str) -> Backend:
    """A back end by name.

    Raises:
        UnknownName: there is none of that name.
    """
    if name not in BACKENDS:
        raise UnknownName("solver back end", name, BACKENDS, where)
    return BACKENDS[name]
