"""Disturbance: what acts on the plant and what no controller is told of."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from aerotact.exceptions import InputError

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant

_TICK = 1e-9  # s; the plant's clock is a sum of timesteps


class Disturbance(Protocol):
    """Anything that disturbs: a force, wind, a wrong mass.

    `begin` is called once when the disturbance joins a plant and may change `plant.model` for good (a mass, a rotor's
    range). `apply` is called at the start of each physics step and may call `plant.push` and `plant.push_tool`; what is
    pushed acts for that one step.
    """

    def begin(self, plant: "Plant") -> None:
        """Join a plant."""

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""


@dataclass(frozen=True)
class ToolForce:
    """A force with a constant direction in W at a point of the tool, like a cable that pulls (ryll2019 Figure 6a).

    Attributes:
        force_W: N, in W.
        start: time at which it begins, s.
        stop: time at which it has ended, s.
        offset_E: point of attack in E, m; zero is the tool's tip.
        ramp: time in which it grows linearly after `start` and falls linearly before `stop`, s.

    Raises:
        InputError: a value that is not finite or of the wrong shape, stop before start, a ramp that is negative or
            longer than half of the time.
    """

    force_W: tuple[float, float, float]
    start: float
    stop: float
    offset_E: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0

    def __post_init__(self) -> None:
        for name in ("force_W", "offset_E"):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"ToolForce: {name} is {value.tolist()}; valid: three finite numbers")
        if not 0.0 <= self.start < self.stop:
            raise InputError(f"ToolForce: start {self.start} s and stop {self.stop} s; valid: 0 <= start < stop")
        if not 0.0 <= self.ramp <= 0.5 * (self.stop - self.start):
            raise InputError(
                f"ToolForce: ramp is {self.ramp} s; valid: 0 to half of stop - start = {self.stop - self.start:g} s"
            )

    def share(self, time: float) -> float:
        """Fraction of the force that acts at `time` (s), 0 to 1."""
        if not self.start - _TICK <= time < self.stop - _TICK:
            return 0.0
        if self.ramp == 0.0:
            return 1.0
        return max(0.0, min(1.0, (time - self.start) / self.ramp, (self.stop - time) / self.ramp))

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            InputError: the robot has no tool.
        """
        if not plant.robot.has_tool:
            raise InputError(f"ToolForce: robot '{plant.robot.name}' has no tool; valid: a robot with robot.tool")

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        share = self.share(plant.time)
        if share > 0.0:
            plant.push_tool(share * np.asarray(self.force_W), offset_E=np.asarray(self.offset_E))
