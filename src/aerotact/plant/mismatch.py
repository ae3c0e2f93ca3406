"""Mismatch: disturbances that make the plant another machine than the one that controllers are told of."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError
from aerotact.plant.disturbance import check_vector
from aerotact.plant_file import subtree
from aerotact.ports import Array

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class MassError:
    """All masses and inertias of the robot larger by a share; 0.05 is 5 %.

    Raises:
        InputError: a share of -1 or less, or not finite.
    """

    share: float

    def __post_init__(self) -> None:
        if not -1.0 < self.share < np.inf:
            raise InputError(f"MassError: share is {self.share}; valid: above -1")

    def begin(self, plant: "Plant") -> None:
        """Join a plant."""
        bodies = subtree(plant.model, plant.base_id)
        plant.model.body_mass[bodies] *= 1.0 + self.share
        plant.model.body_inertia[bodies] *= 1.0 + self.share
        _recompute(plant)

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""


@dataclass(frozen=True)
class CentreOfMassError:
    """The robot's centre of mass moved by `offset_B`, m, with the base's own inertia unchanged.

    Raises:
        InputError: not three finite numbers.
    """

    offset_B: tuple[float, float, float]

    def __post_init__(self) -> None:
        check_vector("CentreOfMassError: offset_B", self.offset_B)

    def begin(self, plant: "Plant") -> None:
        """Join a plant."""
        model, base = plant.model, plant.base_id
        total = model.body_mass[subtree(model, base)].sum()
        model.body_ipos[base] += np.asarray(self.offset_B) * total / model.body_mass[base]
        # MuJoCo's short cuts for a body whose inertial frame is its own no longer hold.
        model.body_sameframe[base] = 0
        model.body_simple[base] = 0
        first = model.body_dofadr[base]
        model.dof_simplenum[first : first + model.body_dofnum[base]] = 0
        _recompute(plant)

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""


@dataclass(frozen=True)
class ToolYawError:
    """The tool, with what measures at it, turned by `angle` (rad) about z of B against where it should be.

    Raises:
        InputError: an angle that is not finite.
    """

    angle: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.angle):
            raise InputError(f"ToolYawError: angle is {self.angle} rad; valid: a finite number")

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            InputError: the robot has no tool on a body of its own, welded to the base.
        """
        model, body = plant.model, plant.tip.body
        if body < 0 or model.body_parentid[body] != plant.base_id or model.body_jntnum[body]:
            raise InputError(
                f"ToolYawError: robot '{plant.robot.name}' has no such tool; "
                "valid: one on a body of its own, welded to the base"
            )
        turn = np.array([np.cos(self.angle / 2), 0.0, 0.0, np.sin(self.angle / 2)])
        position, attitude = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(position, model.body_pos[body], turn)
        mujoco.mju_mulQuat(attitude, turn, model.body_quat[body])
        model.body_pos[body], model.body_quat[body] = position, attitude
        _recompute(plant)

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""


@dataclass
class TiltError:
    """Angles between the shafts of the tilt servos, which their encoders measure, and the rotors that they turn.

    Attributes:
        zero: error of the zero of each, rad, in the order of `robot.tilts`; one number is that of all.
        backlash: width of the gears' play, rad: on a change of direction a shaft turns so far before its rotor follows.

    Raises:
        InputError: a backlash below zero, a number that is not finite.
    """

    zero: tuple[float, ...] | float = 0.0
    backlash: float = 0.0
    _followed: Array = field(default_factory=lambda: np.zeros(0), init=False, repr=False)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.zero).all() and 0.0 <= self.backlash < np.inf):
            raise InputError(f"TiltError: zero {self.zero} rad, backlash {self.backlash} rad; valid: finite, and >= 0")

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            InputError: no rotor tilts, or not one zero error for each.
        """
        count = len(plant.robot.tilts)
        if count == 0 or np.shape(self.zero) not in ((), (count,)):
            raise InputError(
                f"TiltError: zero has shape {np.shape(self.zero)}, robot '{plant.robot.name}' has {count} tilting "
                "rotors; valid: one number, or one for each of at least one"
            )

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        shaft = plant.servos.shaft()
        if plant.time < plant.timestep / 2:
            self._followed = shaft
        self._followed = np.clip(self._followed, shaft - self.backlash / 2, shaft + self.backlash / 2)
        plant.servos.misalign(self.zero + self._followed - shaft)


def _recompute(plant: "Plant") -> None:
    """What MuJoCo derives from masses and places, and the present state from it."""
    mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
    mujoco.mj_forward(plant.model, plant.data)
