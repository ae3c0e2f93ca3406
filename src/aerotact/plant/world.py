"""World: an MJCF fragment with what a robot can touch and see, found by name or path and joined to its plant."""

from pathlib import Path
from typing import Any

import mujoco

from aerotact.exceptions import InputError, UnknownName

_FOLDER = Path(__file__).resolve().parent / "worlds"


def world_files() -> dict[str, Path]:
    """Name -> file of every world of the package."""
    return {path.stem: path for path in sorted(_FOLDER.glob("*.xml"))}


def find_world(name_or_path: str | Path) -> Path:
    """File of a world given by path or by name.

    Raises:
        UnknownName: no such file and no world of that name.
    """
    path = Path(name_or_path)
    if path.suffix == ".xml" and path.is_file():
        return path.resolve()
    files = world_files()
    if str(name_or_path) not in files:
        raise UnknownName("world", str(name_or_path), files)
    return files[str(name_or_path)]


def attach_world(spec: Any, name_or_path: str | Path) -> None:
    """Add a world's geoms, lights and assets to a robot's `mujoco.MjSpec`; the robot's own options stay.

    Names keep as they are. Geoms that can be touched have names that start with "surface"; friction[0] of such a geom
    is the Coulomb coefficient of the tip on it. A surface that brings its own solref has a priority above the tip's and
    condim 1, since friction is added by the plant.

    Raises:
        UnknownName: no such world.
        InputError: the file is not valid MJCF, or a name in it is taken by the robot.
    """
    path = find_world(name_or_path)
    try:
        world = mujoco.MjSpec.from_file(str(path))
        spec.attach(world, prefix="", frame=spec.worldbody.add_frame())
    except ValueError as error:
        reason = str(error).strip().replace("\n", " ")
        raise InputError(f"world {path}: {reason}; valid: an MJCF file without names that the robot uses") from error
