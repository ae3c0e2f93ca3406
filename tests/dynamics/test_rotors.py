"""The rotors' wrench: every rotor turned about its hinge by a rotation matrix, derivatives, and least thrust."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.dynamics.rotors import (
    allocation,
    allocation_parts,
    least_thrust,
    least_thrust_inverse,
    tilting,
    wrench_jacobian,
    wrench_rank,
)
from aerotact.ports import Array
from aerotact.robot import Robot, Tilt


def _hinge(rng: np.random.Generator, near: Array) -> Tilt:
    axis = rng.normal(size=3)
    return Tilt("j", "s", 0, near + 0.05 * rng.normal(size=3), axis / np.linalg.norm(axis), (-3, 3), (-6, 6), 0.05)


@pytest.fixture(scope="module")
def skew(models: dict[str, Model]) -> Robot:
    """The octorotor with three of its rotors on hinges in odd places, none of them square to the thrust."""
    rng, robot = np.random.default_rng(1), models["octorotor"].robot
    rotors = tuple(replace(r, tilt=_hinge(rng, r.p_BR)) if i in (1, 4, 6) else r for i, r in enumerate(robot.rotors))
    return replace(robot, rotors=rotors, hover_tilt=np.array([0.3, -0.7, 1.1]))


def _turned(robot: Robot, thrust: Array, tilt: Array) -> Array:
    """The wrench at the centre of mass, rotor by rotor."""
    wrench, angles = np.zeros(6), iter(tilt)
    for rotor, T in zip(robot.rotors, thrust, strict=True):
        p, a = rotor.p_BR, rotor.axis_B
        if rotor.tilt is not None:
            R = Rotation.from_rotvec(next(angles) * rotor.tilt.axis_B)
            p, a = rotor.tilt.p_BH + R.apply(p - rotor.tilt.p_BH), R.apply(a)
        wrench += np.concatenate([T * a, np.cross(p - robot.p_BC, T * a) + rotor.drag * T * a])
    return wrench


def test_wrench_of_rotors_on_skew_hinges(skew: Robot) -> None:
    rng, model = np.random.default_rng(2), Model(skew)
    assert tilting(skew) == [1, 4, 6]
    for _ in range(20):
        thrust, tilt = rng.uniform(0, 10, 8), rng.uniform(-7, 7, 3)
        expected = _turned(skew, thrust, tilt)
        np.testing.assert_allclose(allocation(skew, tilt) @ thrust, expected, atol=1e-12)
        wrench = ca.vertcat(*model.rotor_wrench(ca.DM(thrust), ca.DM(tilt)))
        np.testing.assert_allclose(wrench.full().ravel(), expected, atol=1e-12)


def test_wrench_of_the_robot(tilting: Model) -> None:
    rng, robot = np.random.default_rng(3), tilting.robot
    thrust, tilt = rng.uniform(0, 20, 6), rng.uniform(-7, 7, 6)
    np.testing.assert_allclose(allocation(robot, tilt) @ thrust, _turned(robot, thrust, tilt), atol=1e-12)
    A_0, A_c, A_s = allocation_parts(robot)
    np.testing.assert_array_equal(A_0, 0.0)
    assert np.linalg.matrix_rank(np.hstack([A_c, A_s])) == 6


def test_jacobian_by_finite_differences(skew: Robot, tilting: Model) -> None:
    for robot in (skew, tilting.robot):
        n, step = len(robot.rotors), 1e-6
        at = np.concatenate([robot.hover_thrust, robot.hover_tilt])
        columns = [
            (_turned(robot, *np.split(at + e, [n])) - _turned(robot, *np.split(at - e, [n]))) / (2 * step)
            for e in step * np.eye(at.size)
        ]
        np.testing.assert_allclose(wrench_jacobian(robot), np.array(columns).T, atol=1e-8)


def test_rank(model: Model, tilting: Model) -> None:
    assert wrench_rank(model.robot) == 6
    robot = tilting.robot
    stuck = replace(robot, rotors=tuple(replace(r, tilt=None) for r in robot.rotors), hover_tilt=np.zeros(0))
    assert wrench_rank(stuck) == 4


def test_least_thrust_of_fixed_rotors(models: dict[str, Model]) -> None:
    for robot in (models["tilt_hex"].robot, models["octorotor"].robot):
        wrench = np.random.default_rng(10).normal(size=6)
        A, thrust = allocation(robot), least_thrust_inverse(robot) @ wrench
        np.testing.assert_allclose(A @ thrust, wrench, atol=1e-12)
        assert np.linalg.norm(thrust) == pytest.approx(np.linalg.norm(np.linalg.lstsq(A, wrench, rcond=None)[0]))
        np.testing.assert_allclose(least_thrust(robot, ca.DM(wrench))[0].full().ravel(), thrust, atol=1e-12)


def test_least_thrust_of_tilting_rotors(tilting: Model) -> None:
    rng, robot = np.random.default_rng(11), tilting.robot
    for _ in range(20):
        wrench, now = rng.normal(size=6) * [20, 20, 40, 2, 2, 2], rng.uniform(-6, 6, 6)
        thrust, tilt = (v.full().ravel() for v in least_thrust(robot, ca.DM(wrench), ca.DM(now)))
        np.testing.assert_allclose(_turned(robot, thrust, tilt), wrench, atol=1e-6)
        assert (thrust > 0).all()
        assert np.abs(tilt - now).max() <= np.pi + 1e-9
        # Of all thrusts and angles with this wrench, none has a smaller sum of squares: it is a sum of columns.
        parts = np.concatenate([thrust * np.cos(tilt), thrust * np.sin(tilt)])
        basis = np.hstack(allocation_parts(robot)[1:])
        np.testing.assert_allclose(np.linalg.pinv(basis) @ basis @ parts, parts, atol=1e-6)


def test_angle_of_least_thrust_goes_on_through_pi(tilting: Model) -> None:
    """The force wanted turns about the axis of an arm by more than a turn; the angles follow without a jump."""
    robot, tilt, seen = tilting.robot, tilting.robot.hover_tilt, []
    for angle in np.linspace(0, 8, 200):
        turned = Rotation.from_rotvec(angle * robot.tilts[1].axis_B).apply([0, 0, 49.0])
        tilt = least_thrust(robot, ca.DM(np.concatenate([turned, np.zeros(3)])), ca.DM(tilt))[1].full().ravel()
        seen.append(tilt)
    assert np.abs(np.diff(seen, axis=0)).max() < 0.2
    assert seen[-1][1] == pytest.approx(8.0, abs=0.3)
