"""Gust: unsteady air on one body of the robot."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.disturbance import check_vector
from aerotact.ports import Array

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass
class Gust:
    """A force at a body's centre of mass: a steady part and a first-order Gauss-Markov process in each axis of W.

    The process draws from `plant.rng` and begins with its stationary spread.

    Attributes:
        body: name of the body.
        deviation: standard deviation of each component, N.
        time_constant: of the process, s.
        steady_W: mean force, N.

    Raises:
        InputError: a deviation below zero, a time constant that is not above zero, a force that is not finite.
    """

    body: str
    deviation: float
    time_constant: float
    steady_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _level: Array | None = field(default=None, init=False, repr=False)
    _index: int = field(default=-1, init=False, repr=False)

    def __post_init__(self) -> None:
        check_vector("Gust: steady_W", self.steady_W)
        if not (0.0 <= self.deviation < np.inf and 0.0 < self.time_constant < np.inf):
            raise InputError(
                f"Gust: deviation {self.deviation} N, time constant {self.time_constant} s; valid: >= 0 and > 0"
            )

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            UnknownName: no such body.
        """
        model = plant.model
        self._index, self._level = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body), None
        if self._index < 0:
            raise UnknownName("body", self.body, [model.body(i).name for i in range(1, model.nbody)], "the plant")

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        fresh = plant.rng.normal(size=3)
        if self._level is None or plant.time < plant.timestep / 2:
            self._level = fresh
        else:
            kept = np.exp(-plant.timestep / self.time_constant)
            self._level = kept * self._level + np.sqrt(1 - kept**2) * fresh
        force = np.asarray(self.steady_W) + self.deviation * self._level
        plant.push(self._index, force, plant.data.xipos[self._index])
