"""References: velocities and accelerations are the derivatives of the poses, and motions start and end at rest."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.experiments.reference import Hold, Waypoints, WithFlags
from aerotact.ports import Array

STEP = 1e-4  # s, of the finite differences
TIMES = [1.0, 2.0, 2.5, 4.0, 6.0]
START_P, START_Q = np.array([0.3, -0.2, 1.1]), np.array([0.5, -0.5, 0.5, 0.5])
DERIVATIVES = ("v_WE_d", "w_E_d", "a_WE_d", "dw_E_d")


def _tour(largest_turn: float = 2.5) -> Waypoints:
    rng = np.random.default_rng(7)
    offsets, turns = rng.normal(size=(2, 5, 3))
    turns *= largest_turn / np.linalg.norm(turns, axis=1, keepdims=True)
    offsets[[0, -1]] = turns[[0, -1]] = 0.0
    return Waypoints(START_P, START_Q, TIMES, offsets, turns)


def _attitude(sample: dict[str, Array]) -> Rotation:
    return Rotation.from_quat(sample["q_WE_d"], scalar_first=True)


@pytest.mark.parametrize("largest_turn", [2.5, 0.3, 1e-3, 0.0])
def test_motion_is_the_derivative_of_the_pose(largest_turn: float) -> None:
    tour, times = _tour(largest_turn), np.linspace(1.01, 5.99, 400)
    before, now, after = (tour.sample(times + shift) for shift in (-STEP, 0.0, STEP))
    v = (after["p_WE_d"] - before["p_WE_d"]) / (2 * STEP)
    a = (after["p_WE_d"] - 2 * now["p_WE_d"] + before["p_WE_d"]) / STEP**2
    w = (_attitude(before).inv() * _attitude(after)).as_rotvec() / (2 * STEP)
    dw = (after["w_E_d"] - before["w_E_d"]) / (2 * STEP)
    np.testing.assert_allclose(now["v_WE_d"], v, atol=1e-5)
    np.testing.assert_allclose(now["a_WE_d"], a, atol=1e-4)
    np.testing.assert_allclose(now["w_E_d"], w, atol=2e-5)
    np.testing.assert_allclose(now["dw_E_d"], dw, atol=1e-4)
    assert np.abs(v).max() > 0.1
    assert np.abs(w).max() >= 0.5 * largest_turn


def test_motion_passes_through_the_waypoints() -> None:
    offsets = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0.0, 0, 0]])
    turns = np.array([[0, 0, 0], [0, 0, 1.5], [0.3, -0.2, 0.1], [0, 0.5, 0]])
    sample = Waypoints(START_P, START_Q, [0.0, 1.0, 3.0, 4.0], offsets, turns).sample(np.array([0.0, 1.0, 3.0, 4.0]))
    np.testing.assert_allclose(sample["p_WE_d"], START_P + offsets, atol=1e-12)
    start = Rotation.from_quat(START_Q, scalar_first=True)
    np.testing.assert_allclose((start.inv() * _attitude(sample)).as_rotvec(), turns, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sample["q_WE_d"], axis=1), 1.0, atol=1e-14)


def test_motion_rests_before_and_after_and_joins_the_rest_smoothly() -> None:
    tour = _tour()
    outside = tour.sample(np.array([-5.0, 0.0, 1.0, 6.0, 6.5, 100.0]))
    for name in DERIVATIVES:
        np.testing.assert_array_equal(outside[name], 0.0)
    np.testing.assert_allclose(outside["p_WE_d"], np.tile(START_P, (6, 1)), atol=1e-12)
    just_inside = tour.sample(np.array([1.0 + 1e-6, 6.0 - 1e-6]))
    for name in DERIVATIVES:
        np.testing.assert_allclose(just_inside[name], 0.0, atol=1e-2)


def test_hold_rests() -> None:
    sample = Hold(START_P, START_Q).sample(np.array([0.0, 3.0]))
    np.testing.assert_array_equal(sample["p_WE_d"], [START_P, START_P])
    np.testing.assert_array_equal(sample["q_WE_d"], [START_Q, START_Q])
    for name in DERIVATIVES:
        np.testing.assert_array_equal(sample[name], np.zeros((2, 3)))


def test_flags_are_up_in_their_half_open_interval() -> None:
    reference = WithFlags(Hold(START_P, START_Q), {"calibrate": (1.5, 4.0)})
    sample = reference.sample(np.array([0.0, 1.4, 1.5, 3.9, 4.0, 9.0]))
    np.testing.assert_array_equal(sample["calibrate"][:, 0], [0, 0, 1, 1, 0, 0])
    assert sample["p_WE_d"].shape == (6, 3)
