"""The machine as it flew in experiments D to F: what bodie2021's Section VI tells of, which no controller is told of.

The paper gives no numbers. Zeros and play are what servos of this class have when their horns are set by eye; the
centre of mass errs by what a change of battery or cable moves it. The noise is the level at which the law with the
paper's gains has about the force errors of Table VI: see docs/experiments.md.
"""

import numpy as np

from aerotact.plant.disturbance import Disturbance, WrenchNoise
from aerotact.plant.mismatch import CentreOfMassError, TiltError

BACKLASH = 1.0
"""Play of the servos' gears, degrees."""
NOISE_FORCE = (1.4, 1.4, 3.5)
"""Standard deviation of the wrench noise along B's axes, N: rotors in their own wake are noisiest along thrust."""
NOISE_TORQUE, NOISE_BAND = 0.15, 2.0  # N m, Hz
TILT_ZERO, COM_OFFSET = 1.5, 0.005
"""Largest errors of a machine: of each tilt servo's zero, degrees; of the centre of mass along each axis, m."""


def disturbed_machine(seed: int) -> list[Disturbance]:
    """A drawn machine in its own wake; the sensors have bias and drift of their own."""
    return [*drawn_machine(seed), wrench_noise()]


def drawn_machine(seed: int) -> list[Disturbance]:
    """Wrong zeros and a centre of mass elsewhere, both drawn evenly by the seed of the run, and play in the gears."""
    rng = np.random.default_rng((seed, 2))  # not the sequence of the sensors or of the noise with this seed
    zeros = np.deg2rad(rng.uniform(-TILT_ZERO, TILT_ZERO, 6))
    x, y, z = rng.uniform(-COM_OFFSET, COM_OFFSET, 3).tolist()
    return [TiltError(tuple(zeros.tolist()), float(np.deg2rad(BACKLASH))), CentreOfMassError((x, y, z))]


def wrench_noise() -> Disturbance:
    """Noise of rotors in their own wake and the wall's."""
    return WrenchNoise(NOISE_FORCE, NOISE_TORQUE, NOISE_BAND)
