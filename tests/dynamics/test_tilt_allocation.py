"""Allocation of a wrench to thrusts and tilt angles: exact, least thrust at rest, no jump at pi, within range."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.dynamics.tilt_allocation import QUIET, allocate
from aerotact.exceptions import MissingCapability
from aerotact.ports import Array

SHARES = (1.0, 0.5, 0.1)


def _allocator(model: Model, share: float) -> Callable[[Array, Array], tuple[Array, Array, Array]]:
    """From wrench and angles to thrust, angles commanded and the wrench in reach."""
    w, a = ca.SX.sym("w", 6), ca.SX.sym("a", model.tilts)
    result = allocate(model, w, a, share)
    f = ca.Function("allocate", [w, a], [result.thrust, result.tilt, result.reachable])

    def run(wrench: Array, tilt: Array) -> tuple[Array, Array, Array]:
        thrust, angle, reachable = (v.full().ravel() for v in f(wrench, tilt))
        return thrust, angle, reachable

    return run


def _given(model: Model, thrust: Array, tilt: Array) -> Array:
    return np.concatenate([ca.DM(v).full().ravel() for v in model.rotor_wrench(ca.DM(thrust), ca.DM(tilt))])


def _near_hover(model: Model, rng: np.random.Generator, size: float) -> Array:
    hover = np.array([0, 0, model.robot.mass * model.robot.gravity, 0, 0, 0])
    return hover + size * rng.normal(size=6) * [10, 10, 10, 1, 1, 1]


def _settled(model: Model, wrench: Array, share: float) -> tuple[Array, Array]:
    """Commands when the angles have come to rest."""
    tilt, run = model.robot.hover_tilt, _allocator(model, share)
    for _ in range(400):
        thrust, tilt, _ = run(wrench, tilt)
    return thrust, tilt


@pytest.mark.parametrize("share", SHARES)
def test_reachable_wrench_is_given_exactly(tilting: Model, share: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        wrench = _near_hover(tilting, rng, 0.1)
        thrust, tilt, reachable = _allocator(tilting, share)(wrench, tilting.robot.hover_tilt)
        np.testing.assert_allclose(_given(tilting, thrust, tilt), wrench, atol=1e-9)
        np.testing.assert_allclose(reachable, wrench, atol=1e-9)


@pytest.mark.parametrize("share", SHARES)
def test_angles_at_rest_are_those_of_the_pseudo_inverse(tilting: Model, share: float) -> None:
    """For any share: the weight changes the way, not the goal. The pseudo-inverse is built here anew."""
    rng, robot = np.random.default_rng(2), tilting.robot
    columns = []
    for rotor in robot.rotors:
        assert rotor.tilt is not None
        for angle in (0.0, np.pi / 2):
            axis = Rotation.from_rotvec(angle * rotor.tilt.axis_B).apply(rotor.axis_B)
            columns.append(np.concatenate([axis, np.cross(rotor.p_BR - robot.p_BC, axis) + rotor.drag * axis]))
    inverse = np.linalg.pinv(np.array(columns).T)
    for _ in range(3):
        wrench = _near_hover(tilting, rng, 0.5)
        parts = (inverse @ wrench).reshape(-1, 2)
        thrust, tilt = _settled(tilting, wrench, share)
        np.testing.assert_allclose(thrust, np.hypot(*parts.T), atol=1e-6)
        np.testing.assert_allclose(tilt, np.arctan2(parts[:, 1], parts[:, 0]), atol=1e-6)


def test_smaller_share_turns_less(tilting: Model) -> None:
    wrench = np.array([6.0, 0, tilting.robot.mass * tilting.robot.gravity, 0, 0, 0])
    tilt = 0.15 * np.array([-1, 1, -1, 1, -1, 1])
    turns = [np.abs(_allocator(tilting, share)(wrench, tilt)[1] - tilt).sum() for share in SHARES]
    assert turns[0] > turns[1] > turns[2]


def test_angle_goes_on_through_pi(tilting: Model) -> None:
    """A whole turn of the body about its roll axis: every angle moves in small steps and within its range."""
    weight, tilt = tilting.robot.mass * tilting.robot.gravity, tilting.robot.hover_tilt
    lower, upper = tilting.tilt_limits
    steps, seen, run = [], [], _allocator(tilting, 1.0)
    for roll in np.linspace(0, 2 * np.pi, 2000):
        f_B = Rotation.from_euler("x", roll).inv().apply([0, 0, weight])
        _, after, _ = run(np.concatenate([f_B, np.zeros(3)]), tilt)
        steps.append(np.abs(after - tilt))
        tilt = after
        seen.append(tilt)
        assert (tilt >= lower).all()
        assert (tilt <= upper).all()
    busy = [0, 2, 3, 5]  # the others' axes are the roll axis's perpendicular: their thrust passes through zero
    assert np.max(steps, axis=0)[busy].max() < 0.02
    assert np.abs(np.array(seen)[:, busy]).max() > 3.2, "the turn must lead through pi"


def test_angle_beyond_the_range_comes_back_by_a_whole_turn(tilting: Model) -> None:
    """Asked for a direction just beyond the end of the range, the servo takes the same one a turn away."""
    weight = tilting.robot.mass * tilting.robot.gravity
    upper = tilting.tilt_limits[1]
    wrench = np.array([0, 0, weight, 0, 0, 0])
    tilt = upper.copy()  # a whole number of turns: upright
    assert np.allclose(np.cos(upper), 1)
    side = np.concatenate([[3.0, 0, weight], np.zeros(3)])
    _, after, _ = _allocator(tilting, 1.0)(side, tilt)
    assert (after <= upper + 1e-12).all()
    turned = after < upper - np.pi
    assert turned.any()
    direct = _allocator(tilting, 1.0)(side, np.zeros(tilting.tilts))[1]
    np.testing.assert_allclose(np.cos(after), np.cos(direct), atol=1e-9)
    np.testing.assert_allclose(np.sin(after), np.sin(direct), atol=1e-9)
    np.testing.assert_allclose(_allocator(tilting, 1.0)(wrench, tilt)[1], tilt, atol=1e-9)


def test_angle_stays_where_there_is_no_thrust(tilting: Model) -> None:
    tilt = np.linspace(-1, 1, tilting.tilts)
    thrust, after, _ = _allocator(tilting, 0.5)(np.zeros(6), tilt)
    np.testing.assert_allclose(after, tilt, atol=1e-5)
    assert thrust.max() < 1e-5
    small = 1e-3 * QUIET * tilting.thrust_limits[1][0]
    _, after, _ = _allocator(tilting, 0.5)(np.array([small, 0, 0, 0, 0, 0]), tilt)
    assert np.abs(after - tilt).max() < 0.01


def test_thrust_waits_for_a_servo_that_points_away(tilting: Model) -> None:
    """Upside down, no thrust is given until the servos have turned; the saturation is told."""
    weight = tilting.robot.mass * tilting.robot.gravity
    wrench = np.array([0, 0, weight, 0, 0, 0])
    thrust, _, reachable = _allocator(tilting, 1.0)(wrench, np.full(tilting.tilts, 2.5))
    assert thrust.max() < 1e-9
    assert reachable[2] < 0.0, "what the idling rotors give"


def test_rotor_that_does_not_tilt_gives_its_one_direction(tilting: Model) -> None:
    rng, robot = np.random.default_rng(3), tilting.robot
    rotors = (replace(robot.rotors[0], tilt=None), *robot.rotors[1:])
    mixed = Model(replace(robot, rotors=rotors, hover_tilt=robot.hover_tilt[1:]))
    for _ in range(10):
        wrench = _near_hover(mixed, rng, 0.05)
        thrust, tilt, _ = _allocator(mixed, 0.5)(wrench, mixed.robot.hover_tilt)
        np.testing.assert_allclose(_given(mixed, thrust, tilt), wrench, atol=1e-9)


def test_hinge_off_the_thrusts_line_is_refused(tilting: Model) -> None:
    robot = tilting.robot
    rotor = robot.rotors[0]
    assert rotor.tilt is not None
    off = replace(rotor, tilt=replace(rotor.tilt, p_BH=rotor.tilt.p_BH + 0.05 * np.cross(rotor.tilt.axis_B, [0, 0, 1])))
    other = Model(replace(robot, rotors=(off, *robot.rotors[1:])))
    with pytest.raises(MissingCapability, match="square to the thrust"):
        _allocator(other, 1.0)(np.zeros(6), robot.hover_tilt)
