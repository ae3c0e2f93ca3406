"""ForceProfile: the desired contact force over time, with sinusoidal ramps (bodie2021 IV-B)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerotact.exceptions import InputError
from aerotact.ports import Array

RAMP_SHARE = 0.1
"""Of the duration of a contact, for each of its two ramps: bodie2021 IV-B holds the force for 80 % of it."""


@dataclass(frozen=True)
class Ramp:
    """Half a period of a cosine from the force before to another.

    Attributes:
        start, stop: s.
        force: from `stop` on, N.
    """

    start: float
    stop: float
    force: float


@dataclass(frozen=True)
class ForceProfile:
    """Force of the tool on the surface along the tool's z axis, continuous with its rate; 0 before the first ramp.

    Attributes:
        ramps: in the order of time.

    Raises:
        InputError: a ramp without duration, or ramps that overlap.
    """

    ramps: Sequence[Ramp]

    def __post_init__(self) -> None:
        free = -np.inf
        for ramp in self.ramps:
            if not free <= ramp.start < ramp.stop:
                span = f"{ramp.start:g} s to {ramp.stop:g} s"
                raise InputError(f"ForceProfile: a ramp from {span}; valid: start < stop, after {free:g} s")
            free = ramp.stop

    def sample(self, times: Array) -> dict[str, Array]:
        """f_ref in N, shape (n, 1)."""
        force, before = np.zeros(len(times)), 0.0
        for ramp in self.ramps:
            x = np.clip((np.asarray(times) - ramp.start) / (ramp.stop - ramp.start), 0.0, 1.0)
            force += (ramp.force - before) * 0.5 * (1.0 - np.cos(np.pi * x))
            before = ramp.force
        return {"f_ref": force[:, None]}


def press(start: float, stop: float, force: float) -> list[Ramp]:
    """Ramps of one contact: up, held for 80 % of the time, down to 0.

    Args:
        start, stop: of the contact, s.
        force: that is held, N.
    """
    ramp = RAMP_SHARE * (stop - start)
    return [Ramp(start, start + ramp, force), Ramp(stop - ramp, stop, 0.0)]
