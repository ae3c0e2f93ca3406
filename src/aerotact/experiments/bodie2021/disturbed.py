"""The machine as it flew in experiments D to F: what bodie2021's Section VI tells of, which no controller is told of.

The paper gives no numbers. These bring the law with the paper's gains to the errors of Table VI, but for the tool's
error across: see docs/experiments.md.
"""

import numpy as np

from aerotact.plant.disturbance import Disturbance, WrenchNoise
from aerotact.plant.mismatch import CentreOfMassError, TiltError

TILT_ZERO = (1.4, 0.6, 1.2, 0.5, 1.5, 0.8)
"""Errors of the tilt servos' zeros, degrees; all of one sign, so that they turn the robot about its vertical axis."""
BACKLASH = 1.0
"""Play of the servos' gears, degrees."""
COM_OFFSET = (0.003, 0.002, 0.005)
"""Of the centre of mass, m in B."""
NOISE_FORCE = (1.4, 1.4, 3.5)
"""Standard deviation of the wrench noise along B's axes, N: rotors in their own wake are noisiest along thrust."""
NOISE_TORQUE, NOISE_BAND = 0.15, 2.0  # N m, Hz


def disturbed_machine() -> list[Disturbance]:
    """Wrong zeros, play, a centre of mass elsewhere, wrench noise; the sensors have bias and drift of their own."""
    zeros = tuple(float(angle) for angle in np.deg2rad(TILT_ZERO))
    return [
        TiltError(zeros, float(np.deg2rad(BACKLASH))),
        CentreOfMassError(COM_OFFSET),
        WrenchNoise(NOISE_FORCE, NOISE_TORQUE, NOISE_BAND),
    ]
