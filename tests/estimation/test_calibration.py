"""Calibrations of bodie2021: centre of mass (27)-(29) and tip of the tool, from data with noise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.calibration import centre_of_mass, tip_from_planes, tip_from_poses
from aerotact.exceptions import InputError
from aerotact.ports import Array

WEIGHT = 5.0 * 9.81


def _attitudes(rng: np.random.Generator, n: int, degrees: float) -> Rotation:
    return Rotation.from_euler("zyx", np.deg2rad(degrees) * rng.uniform(-1, 1, size=(n, 3)))


@pytest.mark.parametrize("seed", range(10))
def test_five_millimetres_are_found_to_a_millimetre(tilting: Model, seed: int) -> None:
    """Rolling and pitching by 20 degrees; rotors' noise from robot.toml, tilt zeros of 0.3 degrees, gusts."""
    rng, robot = np.random.default_rng(seed), tilting.robot
    direction = rng.normal(size=3)
    p_BC = 5e-3 * direction / np.linalg.norm(direction)
    f_true = _attitudes(rng, 2000, 20).inv().apply([0, 0, WEIGHT])
    noise = float(robot.file.sensors.rotor_speed.thrust_noise.array)
    f_B = f_true + noise * np.sqrt(6) * rng.normal(size=f_true.shape)
    tau_B = np.cross(p_BC, f_true) + (0.3 * noise * np.sqrt(6) + 0.05) * rng.normal(size=f_true.shape)
    skew_of_zeros = np.deg2rad(0.3) * rng.normal(size=3)
    f_B = f_B + np.cross(skew_of_zeros, f_B)
    assert np.linalg.norm(centre_of_mass(f_B, tau_B) - p_BC) < 1e-3


def test_printed_normal_equations_of_28_give_the_same() -> None:
    rng = np.random.default_rng(20)
    f = _attitudes(rng, 50, 30).inv().apply([0, 0, WEIGHT])
    tau = np.cross([0.003, -0.002, 0.004], f) + 0.01 * rng.normal(size=f.shape)
    X = np.concatenate([-np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in f])
    np.testing.assert_allclose(centre_of_mass(f, tau), np.linalg.solve(X.T @ X, X.T @ tau.ravel()), atol=1e-9)


def test_level_hover_alone_does_not_tell_the_height() -> None:
    f = np.tile([0.0, 0.0, WEIGHT], (100, 1))
    with pytest.raises(InputError, match="roll and pitch"):
        centre_of_mass(f, np.cross([0.005, 0, 0], f))


def _turning(rng: np.random.Generator, p_BE: Array, n: int = 500) -> tuple[Array, Rotation, Array]:
    """The tip rests on a point of the floor while the robot is turned about it by up to 40 degrees."""
    at, R_WB = np.array([0.4, -0.3, 0.0]), _attitudes(rng, n, 40)
    return at - R_WB.apply(p_BE), R_WB, at


@pytest.mark.parametrize("seed", range(5))
def test_tip_is_found_from_motion_capture(tilting: Model, seed: int) -> None:
    rng, p_BE = np.random.default_rng(seed), tilting.robot.p_BE
    p_WB, R_WB, at = _turning(rng, p_BE)
    measured = (R_WB * Rotation.from_rotvec(0.002 * rng.normal(size=(len(p_WB), 3)))).as_quat(scalar_first=True)
    tip, point = tip_from_poses(p_WB + 3e-4 * rng.normal(size=p_WB.shape), measured)
    np.testing.assert_allclose(tip, p_BE, atol=1e-3)
    np.testing.assert_allclose(point, at, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_tip_is_found_from_planes_seen(seed: int) -> None:
    """Noise of 2 mm and 0.3 degrees on the planes that the camera sees."""
    rng, p_CE = np.random.default_rng(seed), np.array([0.03, -0.05, 0.45])
    _, R_WC, at = _turning(rng, p_CE)
    p_WC = at - R_WC.apply(p_CE)
    n_C = R_WC.inv().apply([0, 0, 1])
    distance = -p_WC[:, 2]
    seen = Rotation.from_rotvec(np.deg2rad(0.3) * rng.normal(size=n_C.shape)).apply(n_C)
    np.testing.assert_allclose(tip_from_planes(seen, distance + 2e-3 * rng.normal(size=500)), p_CE, atol=2e-3)


def test_turning_about_one_axis_is_refused() -> None:
    R_WC = Rotation.from_euler("x", np.linspace(-0.5, 0.5, 50)[:, None])
    with pytest.raises(InputError, match="all three axes"):
        tip_from_planes(R_WC.inv().apply([0, 0, 1]), np.full(50, 0.4))
    with pytest.raises(InputError, match="all three axes"):
        tip_from_poses(np.zeros((50, 3)), R_WC.as_quat(scalar_first=True))


@pytest.mark.parametrize(
    ("f", "tau"),
    [(np.zeros((3, 2)), np.zeros((3, 3))), (np.zeros((3, 3)), np.zeros((4, 3))), ([[np.nan] * 3], [[0] * 3])],
)
def test_wrong_data_is_refused(f: Array, tau: Array) -> None:
    with pytest.raises(InputError):
        centre_of_mass(f, tau)
