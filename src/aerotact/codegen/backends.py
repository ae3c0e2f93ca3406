"""Back ends: who solves the quadratic programme. Each gives C files with the interface of templates/qp/qp.h.jinja."""

from collections.abc import Callable
from dataclasses import dataclass

from aerotact.codegen.hpipm_sources import hpipm_sources
from aerotact.codegen.precision import files_in_single_precision
from aerotact.codegen.qp_structure import Places, QpPattern, template_context, workspace_places
from aerotact.codegen.templating import templates
from aerotact.exceptions import UnknownName

Sources = Callable[[str, QpPattern], dict[str, str]]
"""(prefix, pattern) -> path inside the project -> text; what others wrote goes below third_party/."""


@dataclass(frozen=True)
class Backend:
    """A back end.

    Attributes:
        sources: its C files.
        places: where a stage's matrices and vectors are kept; arrays are members of the real-time iteration's struct.
        caveat: what its users must know, one sentence for header, README and manifest; empty if there is nothing.
        linked: libraries that are not carried along, by the names of codegen/linked.py.
    """

    sources: Sources
    places: Callable[[QpPattern], Places]
    caveat: str = ""
    linked: tuple[str, ...] = ()


def aerotact_qp(prefix: str, pattern: QpPattern) -> dict[str, str]:
    """Warm-started active set, splitting and interior point on one structured Riccati recursion."""
    environment = templates()
    context = template_context(prefix, pattern)
    files = {
        f"include/{prefix}_qp.h": environment.get_template("qp/qp.h.jinja").render(context),
        f"src/{prefix}_qp.c": environment.get_template("qp/qp.c.jinja").render(context),
    }
    return files_in_single_precision(files) if pattern.single else files


def aerotact_places(pattern: QpPattern) -> Places:
    """The solver's own arrays."""
    return {key: [(f"qp_workspace.{a}", i) for a, i in places] for key, places in workspace_places(pattern).items()}


def data_places(pattern: QpPattern) -> Places:
    """The data's: of back ends that have no arrays for a stage."""
    nx, nu = pattern.nx, pattern.nu
    sizes = {"A": nx * nx, "B": nx * nu, "b": nx, "Q": nx * nx, "S": nu * nx, "R": nu * nu, "q": nx, "r": nu}
    return {(name, i): [(f"qp_data.{name}", i)] for name, size in sizes.items() for i in range(size)}


def osqp_qp(prefix: str, pattern: QpPattern) -> dict[str, str]:
    """OSQP's embedded code; the package is imported only when it is wanted."""
    from aerotact.codegen.osqp_sources import osqp_sources  # noqa: PLC0415

    return osqp_sources(prefix, pattern)


BACKENDS: dict[str, Backend] = {
    "aerotact": Backend(aerotact_qp, aerotact_places),
    "osqp": Backend(
        osqp_qp,
        data_places,
        "OSQP's work arrays are variables of this library: steps must not overlap, whatever their workspace.",
    ),
    "hpipm": Backend(
        hpipm_sources,
        data_places,
        "HPIPM and BLASFEO are linked: the target must have them.",
        ("hpipm", "blasfeo"),
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
