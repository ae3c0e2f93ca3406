"""The machine as it flew in experiments D to F: what bodie2021's Section VI tells of, which no controller is told of.

The paper gives no numbers. Each seed is another machine, drawn from what such a machine is assembled and weighed to:

    tilt zeros         a part common to all servos (one jig) and one of each (its spline), degrees of angle by eye
    play               of the gears of servos of this class, the same in all machines
    centre of mass     millimetres, as after a calibration, and once more after a change of battery
    mass               a share, as a change of battery moves it
    wrench noise       rotors in their own wake and the wall's: the level at which the law with the paper's gains has
                       about the force errors of Table VI; a machine's own level lies about it
"""

import numpy as np

from aerotact.plant.disturbance import Disturbance, WrenchNoise
from aerotact.plant.mismatch import CentreOfMassError, MassError, TiltError

TILT_COMMON, TILT_OWN = 1.0, 0.5
"""Zeros of the tilt servos, degrees: mean over the servos, which turns the robot about its vertical axis, and deviation."""
BACKLASH = 1.0
"""Play of the servos' gears, degrees."""
COM_OFFSET = 0.003
"""Of the centre of mass along each axis of B, standard deviation, m."""
MASS = 0.01
"""Of the mass, standard deviation, as a share."""
NOISE_FORCE, NOISE_TORQUE = (1.4, 1.4, 3.5), 0.15
"""Standard deviation of the wrench noise along B's axes, N, rotors being noisiest along thrust, and of its torque, N m."""
NOISE_BAND = 2.0  # Hz
NOISE_SPREAD = 0.1
"""Standard deviation of a machine's noise level, as a share."""
WITHIN = 2.0
"""Every draw is cut at this many standard deviations: a machine outside would be repaired."""


def disturbed_machine(seed: int) -> list[Disturbance]:
    """One such machine; the sensors have bias and drift of their own.

    Args:
        seed: of the run.
    """
    rng = np.random.default_rng((seed, 2))  # not the sequence of plant or sensors with this seed

    def normal(size: int) -> np.ndarray:
        return np.clip(rng.normal(size=size), -WITHIN, WITHIN)

    zeros = np.deg2rad(TILT_COMMON + TILT_OWN * normal(6))
    com, level = COM_OFFSET * normal(3), float(1.0 + NOISE_SPREAD * normal(1)[0])
    return [
        TiltError(tuple(map(float, zeros)), float(np.deg2rad(BACKLASH))),
        MassError(float(MASS * normal(1)[0])),
        CentreOfMassError((float(com[0]), float(com[1]), float(com[2]))),
        WrenchNoise(
            (level * NOISE_FORCE[0], level * NOISE_FORCE[1], level * NOISE_FORCE[2]), level * NOISE_TORQUE, NOISE_BAND
        ),
    ]
