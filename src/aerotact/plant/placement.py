"""Placement: a body of the world is put elsewhere before the experiment begins."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import UnknownName
from aerotact.plant.disturbance import check_vector

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class Placement:
    """A body of the world stands, or starts if it is free, at another place.

    Attributes:
        body: its name.
        p_W: of its origin, m.

    Raises:
        InputError: a place that is not three finite numbers.
    """

    body: str
    p_W: tuple[float, float, float]

    def __post_init__(self) -> None:
        check_vector("Placement: p_W", self.p_W)

    def begin(self, plant: "Plant") -> None:
        """Put it there.

        Raises:
            UnknownName: no such body.
        """
        model = plant.model
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body)
        if index < 0:
            raise UnknownName("body", self.body, [model.body(i).name for i in range(1, model.nbody)], "the plant")
        joint = model.body_jntadr[index]
        if model.body_jntnum[index] and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            first = int(model.jnt_qposadr[joint])
            plant.start_at(slice(first, first + 3), np.asarray(self.p_W))
        else:
            model.body_pos[index] = self.p_W

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
