"""plant.xml, compiled by MuJoCo: its parts by name, and what the bodies weigh together."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from aerotact.exceptions import RobotError
from aerotact.ports import Array


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings instead of letting it write a log file into the working directory."""
    caught: list[str] = []
    mujoco.set_mju_user_warning(caught.append)
    try:
        yield caught
    finally:
        mujoco.set_mju_user_warning(lambda message: None)


def compile_plant(path: Path) -> Any:
    """The `mujoco.MjModel` of plant.xml.

    Raises:
        RobotError: the file is missing, cannot be compiled, or MuJoCo warns.
    """
    if not path.is_file():
        raise RobotError(path, "file", "does not exist", "a robot folder holds plant.xml and robot.toml")
    with mujoco_warnings() as warnings:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise RobotError(path, "model", str(error).strip().replace("\n", " "), "mend the named element") from error
    if warnings:
        raise RobotError(path, "model", f"MuJoCo warns: {warnings[0]}", "mend the cause of the warning")
    return model


def find_id(model: Any, kind: Any, name: str, part: str, folder: Path) -> int:
    """Id of the element of this kind (`mujoco.mjtObj`) that `part` of robot.toml names.

    Raises:
        RobotError: there is none; names those that there are.
    """
    index = mujoco.mj_name2id(model, kind, name)
    if index < 0:
        label = kind.name.removeprefix("mjOBJ_").lower()
        counts = {"body": model.nbody, "joint": model.njnt, "site": model.nsite, "actuator": model.nu}
        count = (counts | {"key": model.nkey})[label]
        names = [mujoco.mj_id2name(model, kind, i) or f"(unnamed {i})" for i in range(count)]
        raise RobotError(
            folder / "robot.toml",
            part,
            f"plant.xml has no {label} '{name}'",
            f"name one of: {', '.join(names) or f'none, so add a {label}'}",
        )
    return int(index)


def joints_between(model: Any, body: int, base: int) -> list[int]:
    """Ids of the joints on the way from `body` up to `base`, without the base's own."""
    joints: list[int] = []
    while body not in (base, 0):
        first = model.body_jntadr[body]
        joints += range(first, first + model.body_jntnum[body])
        body = model.body_parentid[body]
    return joints


def subtree(model: Any, root: int) -> list[int]:
    """Ids of a body and of all bodies below it."""
    found = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in found:
            found.append(body)
    return found


def lumped(model: Any, data: Any, bodies: list[int]) -> tuple[float, Array, Array]:
    """Mass, kg, centre of mass, m, and inertia about it, kg m2, of bodies as they stand in `data`, in W's axes."""
    masses = model.body_mass[bodies]
    p_WC = (masses[:, None] * data.xipos[bodies]).sum(axis=0) / (masses.sum() or 1.0)
    inertia = np.zeros((3, 3))
    for body, mass in zip(bodies, masses, strict=True):
        R_WI = data.ximat[body].reshape(3, 3)
        r = data.xipos[body] - p_WC
        inertia += R_WI @ np.diag(model.body_inertia[body]) @ R_WI.T + mass * (r @ r * np.eye(3) - np.outer(r, r))
    return float(masses.sum()), p_WC, inertia
