"""Linked: libraries that a project takes from the machine instead of carrying them along."""

import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from aerotact.exceptions import LibraryNotFound


@dataclass(frozen=True)
class Library:
    """A library as it is installed.

    Attributes:
        name: as the linker has it.
        include, folder: where its headers and its binary are.
    """

    name: str
    include: Path
    folder: Path

    @property
    def version(self) -> str:
        """As its file has it."""
        files = [f.resolve().name for f in self.folder.glob(f"lib{self.name}.so*")]
        found = [m[1] for m in (re.search(r"\.so\.([\d.]+)$", f) for f in files) if m]
        return max(found, key=len, default="of unknown version")


@dataclass(frozen=True)
class _Wanted:
    """What to look for.

    Attributes:
        name: of the library.
        header: one that it has.
        variable: of the environment, names the installation.
        acados: folder of its headers in an acados.
        roots: where it is installed by default.
    """

    name: str
    header: str
    variable: str
    acados: str
    roots: tuple[str, ...]


_KNOWN = {
    name: _Wanted(
        name,
        header,
        f"{name.upper()}_DIR",
        f"include/{name}/include",
        (f"/opt/{name}", "/usr/local", "/usr"),
    )
    for name, header in (("hpipm", "hpipm_d_ocp_qp_ipm.h"), ("blasfeo", "blasfeo_d_aux.h"))
}


def find_library(name: str) -> Library:
    """Where a library is: in the folder that its own variable names, else in $ACADOS_SOURCE_DIR, else where it is
    installed by default.

    Raises:
        LibraryNotFound: nowhere; the message lists the places.
    """
    wanted = _KNOWN[name]
    roots: list[tuple[Path, Path]] = []
    if own := os.environ.get(wanted.variable):
        roots.append((Path(own) / "include", Path(own) / "lib"))
    elif acados := os.environ.get("ACADOS_SOURCE_DIR"):
        roots.append((Path(acados) / wanted.acados, Path(acados) / "lib"))
    else:
        roots += [(Path(r) / "include", Path(r) / "lib") for r in wanted.roots]
    for include, folder in roots:
        if (include / wanted.header).is_file() and any(folder.glob(f"lib{name}.*")):
            return Library(name, include, folder)
    raise LibraryNotFound(name, [str(folder.parent) for _, folder in roots], wanted.variable)


def linked_context(names: Sequence[str]) -> list[dict[str, Any]]:
    """What the build files of a project know of its libraries."""
    return [asdict(_KNOWN[name]) for name in names]


def compile_flags(libraries: Sequence[Library]) -> list[str]:
    """For the compiler; as system headers, whose warnings are not ours."""
    return [word for library in libraries for word in ("-isystem", str(library.include))]


def link_flags(libraries: Sequence[Library]) -> list[str]:
    """For the linker; where they lie is written into what is linked."""
    folders = dict.fromkeys(str(library.folder) for library in libraries)
    return [
        *(f"-L{folder}" for folder in folders),
        *(f"-Wl,-rpath,{folder}" for folder in folders),
        *(f"-l{library.name}" for library in libraries),
    ]
