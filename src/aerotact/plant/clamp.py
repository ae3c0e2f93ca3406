"""Clamp: a bench that holds the base where it is, for experiments with arms alone."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant

MASS = 1e9
"""Added to the base's inertia in each direction, kg and kg m2: it then moves by less than 1e-9 m in a minute."""


@dataclass(frozen=True)
class Clamp:
    """The base neither moves nor turns; its rotors may push as they like."""

    def begin(self, plant: "Plant") -> None:
        """Take hold of the base."""
        first = plant.model.body_dofadr[plant.base_id]
        plant.model.dof_armature[first : first + 6] = MASS

    def apply(self, plant: "Plant") -> None:
        """Act for one step: no speed adds up."""
        first = plant.model.body_dofadr[plant.base_id]
        plant.data.qvel[first : first + 6] = 0.0
