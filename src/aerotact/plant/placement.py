"""Placement: a body of the world is put elsewhere before the experiment begins."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.disturbance import check_vector

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class Placement:
    """A body stands, or starts if it is free, at another place.

    Attributes:
        body: its name; of the world, or the robot's base.
        p_W: of its origin, m.
        spread: it is there but for an error of up to this along each axis, drawn from `plant.rng`, m.

    Raises:
        InputError: a place that is not three finite numbers, a spread below zero.
    """

    body: str
    p_W: tuple[float, float, float]
    spread: float = 0.0

    def __post_init__(self) -> None:
        check_vector("Placement: p_W", self.p_W)
        if not 0.0 <= self.spread < np.inf:
            raise InputError(f"Placement: spread is {self.spread} m; valid: >= 0")

    def begin(self, plant: "Plant") -> None:
        """Put it there.

        Raises:
            UnknownName: no such body.
        """
        model = plant.model
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body)
        if index < 0:
            raise UnknownName("body", self.body, [model.body(i).name for i in range(1, model.nbody)], "the plant")
        joint, p_W = model.body_jntadr[index], np.asarray(self.p_W)
        if self.spread:
            p_W = p_W + plant.rng.uniform(-self.spread, self.spread, 3)
        if model.body_jntnum[index] and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            first = int(model.jnt_qposadr[joint])
            plant.start_at(slice(first, first + 3), p_W)
        else:
            model.body_pos[index] = p_W

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
