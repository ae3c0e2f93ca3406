"""The machine as it flew in experiments D to F: what bodie2021's Section VI tells of, which no controller is told of.

The paper gives no numbers. These bring the law with the paper's gains to the errors of Table VI, but for the tool's
error across: see docs/experiments.md.
"""

import numpy as np

from aerotact.plant.disturbance import Disturbance, WrenchNoise
from aerotact.plant.mismatch import CentreOfMassError, TiltError
from aerotact.ports import Array

TILT_ZERO = (1.4, 0.6, 1.2, 0.5, 1.5, 0.8)
"""Errors of the tilt servos' zeros, degrees; all of one sign, so that they turn the robot about its vertical axis."""
BACKLASH = 1.0
"""Play of the servos' gears, degrees."""
COM_OFFSET = (0.003, 0.002, 0.005)
"""Of the centre of mass, m in B."""
NOISE_FORCE = (1.4, 1.4, 3.5)
"""Standard deviation of the wrench noise along B's axes, N: rotors in their own wake are noisiest along thrust."""
NOISE_TORQUE, NOISE_BAND = 0.15, 2.0  # N m, Hz
DRAWN_ZERO, DRAWN_OFFSET = 1.5, 0.005
"""Largest errors of a drawn machine: of each tilt servo's zero, degrees; of the centre of mass along each axis, m."""


def disturbed_machine() -> list[Disturbance]:
    """Wrong zeros, play, a centre of mass elsewhere, wrench noise; the sensors have bias and drift of their own."""
    return [*_machine(np.array(TILT_ZERO), np.array(COM_OFFSET)), wrench_noise()]


def drawn_machine(seed: int) -> list[Disturbance]:
    """Wrong zeros and a centre of mass elsewhere, both drawn evenly by the seed of the run, and the same play."""
    rng = np.random.default_rng((seed, 2))  # not the sequence of the sensors or of the noise with this seed
    return _machine(rng.uniform(-DRAWN_ZERO, DRAWN_ZERO, 6), rng.uniform(-DRAWN_OFFSET, DRAWN_OFFSET, 3))


def wrench_noise() -> Disturbance:
    """The noise by which the law comes to the force error of Table VI."""
    return WrenchNoise(NOISE_FORCE, NOISE_TORQUE, NOISE_BAND)


def _machine(zeros: Array, offset: Array) -> list[Disturbance]:
    x, y, z = offset.tolist()
    return [
        TiltError(tuple(np.deg2rad(zeros).tolist()), float(np.deg2rad(BACKLASH))),
        CentreOfMassError((x, y, z)),
    ]
