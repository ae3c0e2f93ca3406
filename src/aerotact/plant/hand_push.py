"""HandPush: a hand that moves a body of the world on its slide, against the robot and away from it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.disturbance import check_vector

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class HandPush:
    """A hand holds a body by a spring and a damper and travels; the body can slide along one axis only.

    Attributes:
        body: of the world, with one slide joint.
        start_W: where the body's origin is while nothing has travelled, m.
        way: times, s, increasing, and travels along the slide, m; half a cosine between two, at rest before and after.
        stiffness, damping: of the hand, N/m and N s/m.

    Raises:
        InputError: times that do not increase, numbers that are not finite, a spring or damper below zero.
    """

    body: str
    start_W: tuple[float, float, float]
    way: Sequence[tuple[float, float]]
    stiffness: float = 1500.0
    damping: float = 60.0

    def __post_init__(self) -> None:
        check_vector("HandPush: start_W", self.start_W)
        increasing = all(a[0] < b[0] for a, b in pairwise(self.way))
        if not self.way or not increasing or not np.isfinite(self.way).all():
            raise InputError(f"HandPush: way is {list(self.way)}; valid: (s, m), one or more, increasing, finite")
        if not (self.stiffness >= 0.0 and self.damping >= 0.0):
            raise InputError(f"HandPush: stiffness {self.stiffness}, damping {self.damping}; valid: >= 0")

    def travel(self, time: float) -> tuple[float, float]:
        """Travel of the hand, m, and its speed, m/s, at `time`, s."""
        for (start, before), (stop, after) in pairwise(self.way):
            if start <= time < stop:
                phase = np.pi * (time - start) / (stop - start)
                half = 0.5 * (after - before)
                return before + half * (1 - np.cos(phase)), half * np.sin(phase) * np.pi / (stop - start)
        return (self.way[0][1] if time < self.way[0][0] else self.way[-1][1]), 0.0

    def begin(self, plant: "Plant") -> None:
        """Take the body and bring it to its start.

        Raises:
            UnknownName: no such body.
            InputError: it is not on one slide of its own.
        """
        model = plant.model
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body)
        if index < 0:
            raise UnknownName("body", self.body, [model.body(i).name for i in range(1, model.nbody)], "the plant")
        joint = model.body_jntadr[index]
        if model.body_jntnum[index] != 1 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
            raise InputError(f"HandPush: body '{self.body}' has no slide; valid: a body with one slide joint")
        model.body_pos[index] = self.start_W

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        model, data = plant.model, plant.data
        body = model.body(self.body).id
        joint = model.body_jntadr[body]
        travel, speed = self.travel(plant.time)
        behind, slower = travel - data.qpos[model.jnt_qposadr[joint]], speed - data.qvel[model.jnt_dofadr[joint]]
        force = self.stiffness * behind + self.damping * slower
        plant.push(body, force * data.xaxis[joint], data.xipos[body])
