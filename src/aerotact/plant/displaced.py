"""Displaced: a joint of the robot begins away from hover and is let go."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aerotact.exceptions import InputError, UnknownName

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class Displaced:
    """A joint starts at rest beside its angle of hover; a passive one then swings.

    Attributes:
        joint: its name.
        angle: beyond the angle of the hover keyframe, rad.

    Raises:
        InputError: an angle that is not finite.
    """

    joint: str
    angle: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.angle):
            raise InputError(f"Displaced: angle is {self.angle}; valid: finite, rad")

    def begin(self, plant: "Plant") -> None:
        """Put it there.

        Raises:
            UnknownName: no such joint among the robot's.
        """
        if self.joint not in plant.joints.names:
            raise UnknownName("joint", self.joint, plant.joints.names, f"robot '{plant.robot.name}'")
        address = int(plant.model.jnt_qposadr[plant.model.joint(self.joint).id])
        alone = plant.robot.mjmodel
        hover = alone.key("hover").qpos[alone.jnt_qposadr[alone.joint(self.joint).id]]
        plant.start_at(slice(address, address + 1), np.array([hover + self.angle]))

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
