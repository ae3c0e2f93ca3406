"""Where robot folders and ocp files are found: a path, the working directory, a checkout, or the installed wheel."""

from collections.abc import Iterator
from pathlib import Path

from aerotact.exceptions import UnknownName

_PACKAGE = Path(__file__).resolve().parent


def _roots(kind: str) -> Iterator[Path]:
    """Existing folders called `kind` ("models" or "ocp"), nearest first, each once."""
    seen: set[Path] = set()
    for base in (Path.cwd(), _PACKAGE, _PACKAGE.parents[1]):
        root = (base / kind).resolve()
        if root.is_dir() and root not in seen:
            seen.add(root)
            yield root


def robot_folders() -> dict[str, Path]:
    """Name -> folder of every robot in reach."""
    found: dict[str, Path] = {}
    for root in _roots("models"):
        for toml in sorted(root.glob("*/robot.toml")):
            found.setdefault(toml.parent.name, toml.parent)
    return found


def problem_files() -> dict[str, Path]:
    """Name -> file of every optimal control problem in reach."""
    found: dict[str, Path] = {}
    for root in _roots("ocp"):
        for toml in sorted(root.glob("*.toml")):
            found.setdefault(toml.stem, toml)
    return found


def find_robot(name_or_path: str | Path) -> Path:
    """Folder of a robot given by path or by name.

    Raises:
        UnknownName: no such folder and no robot of that name.
    """
    path = Path(name_or_path)
    if path.is_dir():
        return path.resolve()
    folders = robot_folders()
    if str(name_or_path) not in folders:
        raise UnknownName("robot", str(name_or_path), folders)
    return folders[str(name_or_path)]


def find_problem(name_or_path: str | Path) -> Path:
    """Ocp file given by path or by name.

    Raises:
        UnknownName: no such file and no problem of that name.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml" and path.is_file():
        return path.resolve()
    files = problem_files()
    if str(name_or_path) not in files:
        raise UnknownName("optimal control problem", str(name_or_path), files)
    return files[str(name_or_path)]
