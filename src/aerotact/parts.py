"""Parts: what entries of robot.toml are made of, and where the parts that they name stand in plant.xml."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from aerotact.exceptions import RobotError
from aerotact.ports import Array


class Strict(BaseModel):
    """An entry of robot.toml: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Quantity(Strict):
    """A number or a list of numbers with its unit and where it comes from."""

    value: float | list[float]
    unit: str
    source: str = Field(min_length=1)

    @property
    def array(self) -> Array:
        """The value as an array of shape () or (n,)."""
        return np.asarray(self.value, dtype=float)


def part_id(model: Any, kind: mujoco.mjtObj, name: str, part: str, folder: Path) -> int:
    """Id of a part of plant.xml that robot.toml names.

    Args:
        model: compiled plant.xml.
        kind: body, joint, site, actuator or key.
        name: of the part.
        part: where robot.toml names it.
        folder: of the robot.

    Raises:
        RobotError: there is none of that name; lists those that there are.
    """
    index = mujoco.mj_name2id(model, kind, name)
    if index < 0:
        label = kind.name.removeprefix("mjOBJ_").lower()
        sizes = {"body": "nbody", "joint": "njnt", "site": "nsite", "actuator": "nu", "key": "nkey"}
        names = [mujoco.mj_id2name(model, kind, i) or f"(unnamed {i})" for i in range(getattr(model, sizes[label]))]
        raise RobotError(
            folder / "robot.toml",
            part,
            f"plant.xml has no {label} '{name}'",
            f"name one of: {', '.join(names) or f'none, so add a {label}'}",
        )
    return int(index)
