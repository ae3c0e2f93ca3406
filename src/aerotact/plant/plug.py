"""Plug: a plug in its socket, one in the hand of each of two arms, which comes loose when it is pulled hard enough."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from aerotact.exceptions import InputError
from aerotact.ports import Array

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass
class Plug:
    """A massless rod from one tool to the other, from `start` on, of the length that the tools then have between them.

    Attributes:
        start: s.
        hold: lowest and highest pull at which it comes loose, N; drawn from `plant.rng`.
        stiffness, damping: of the rod, N/m and N s/m.

    Raises:
        InputError: numbers that are not finite or out of order.
    """

    start: float
    hold: tuple[float, float]
    stiffness: float = 2000.0
    damping: float = 4.0
    _length: float = field(default=0.0, init=False, repr=False)
    _limit: float = field(default=0.0, init=False, repr=False)
    _loose: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        numbers = [self.start, *self.hold, self.stiffness, self.damping]
        if not np.isfinite(numbers).all() or min(numbers) < 0 or self.hold[0] > self.hold[1]:
            raise InputError(
                f"Plug: start {self.start} s, hold {self.hold} N, stiffness {self.stiffness}, damping {self.damping}; "
                "valid: finite, >= 0, hold from low to high"
            )

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            InputError: other than two arms.
        """
        if len(plant.robot.arms) != 2:
            raise InputError(f"Plug: robot '{plant.robot.name}' has {len(plant.robot.arms)} arms; valid: two")

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        if plant.time < self.start:
            self._length, self._loose = 0.0, False
            return
        if self._loose:
            return
        (p_1, v_1), (p_2, v_2) = plant.tool_point(0), plant.tool_point(1)
        apart = float(np.linalg.norm(p_1 - p_2))
        if self._length == 0.0:
            self._length, self._limit = apart, float(plant.rng.uniform(*self.hold))
        axis: Array = (p_1 - p_2) / apart
        pull = self.stiffness * (apart - self._length) + self.damping * float(axis @ (v_1 - v_2))
        if pull > self._limit:
            self._loose = True
            return
        plant.push_tool(-pull * axis, np.zeros(3), 0)
        plant.push_tool(pull * axis, np.zeros(3), 1)
