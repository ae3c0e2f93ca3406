"""Disturbance: what acts on the plant and what no controller is told of."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from aerotact.exceptions import InputError
from aerotact.ports import Array

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
class ForcePulse:
    """A force with a constant direction in W for a while.

    Attributes:
        force_W: N, in W.
        start: time at which it begins, s.
        stop: time at which it has ended, s.
        ramp: time in which it grows linearly after `start` and falls linearly before `stop`, s.

    Raises:
        InputError: a value that is not finite or of the wrong shape, stop before start, a ramp that is negative or
            longer than half of the time.
    """

    force_W: tuple[float, float, float]
    start: float
    stop: float
    ramp: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        who = type(self).__name__
        check_vector(f"{who}: force_W", self.force_W)
        if not 0.0 <= self.start < self.stop:
            raise InputError(f"{who}: start {self.start} s and stop {self.stop} s; valid: 0 <= start < stop")
        if not 0.0 <= self.ramp <= 0.5 * (self.stop - self.start):
            raise InputError(
                f"{who}: ramp is {self.ramp} s; valid: 0 to half of stop - start = {self.stop - self.start:g} s"
            )

    def share(self, time: float) -> float:
        """Fraction of the force that acts at `time` (s), 0 to 1."""
        if not self.start - _TICK <= time < self.stop - _TICK:
            return 0.0
        if self.ramp == 0.0:
            return 1.0
        return max(0.0, min(1.0, (time - self.start) / self.ramp, (self.stop - time) / self.ramp))

    def begin(self, plant: "Plant") -> None:
        """Join a plant."""


@dataclass(frozen=True)
class ToolForce(ForcePulse):
    """A force at a point of the tool, like a cable that pulls (ryll2019 Figure 6a).

    Attributes:
        offset_E: point of attack in E, m; zero is the tool's tip.
    """

    offset_E: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_vector("ToolForce: offset_E", self.offset_E)

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


@dataclass(frozen=True)
class Wind(ForcePulse):
    """A steady wind or a gust: a force at the robot's centre of mass."""

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        share = self.share(plant.time)
        if share > 0.0:
            plant.push(plant.base_id, share * np.asarray(self.force_W), plant.data.subtree_com[plant.base_id])


@dataclass
class WrenchNoise:
    """Band-limited noise on the wrench, like that of propellers in their own wake and of turbulence.

    Force and torque are first-order Gauss-Markov processes in B's axes about the centre of mass, from `plant.rng`.

    Attributes:
        force: standard deviation, N: of each component, or one number for each.
        torque: same, N m.
        bandwidth: Hz, of the first-order low-pass behind the noise.

    Raises:
        InputError: a deviation below zero or not of one or three numbers, a bandwidth that is not above zero.
    """

    force: float | tuple[float, float, float]
    torque: float | tuple[float, float, float]
    bandwidth: float = 2.0
    _level: Array = field(default_factory=lambda: np.zeros(6), init=False, repr=False)

    def __post_init__(self) -> None:
        levels = [np.asarray(level, dtype=float) for level in (self.force, self.torque)]
        fine = all(level.shape in ((), (3,)) and (level >= 0.0).all() for level in levels)
        if not (fine and 0.0 < self.bandwidth < np.inf):
            raise InputError(
                f"WrenchNoise: force {self.force} N, torque {self.torque} N m, bandwidth {self.bandwidth} Hz; "
                "valid: one or three numbers >= 0, the same, and > 0"
            )

    def begin(self, plant: "Plant") -> None:
        """Join a plant."""

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        fresh = plant.rng.normal(size=6)
        kept = np.exp(-2 * np.pi * self.bandwidth * plant.timestep) if plant.time > _TICK else 0.0
        self._level = kept * self._level + np.sqrt(1 - kept**2) * fresh
        R_WB = plant.data.xmat[plant.base_id].reshape(3, 3)
        force, torque = np.multiply(self.force, self._level[:3]), np.multiply(self.torque, self._level[3:])
        plant.push(plant.base_id, R_WB @ force, plant.data.subtree_com[plant.base_id], R_WB @ torque)


def check_vector(what: str, value: ArrayLike) -> None:
    """Three finite numbers.

    Raises:
        InputError: names `what`.
    """
    array = np.asarray(value, dtype=float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{what} is {array.tolist()}; valid: three finite numbers")
