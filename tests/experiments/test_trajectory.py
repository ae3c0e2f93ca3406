"""Polynomial motions from rest to rest: derivatives, ends, half turns, chains, set-points at 100 Hz."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.exceptions import InputError
from aerotact.experiments.reference import Hold, Waypoints
from aerotact.experiments.trajectory import (
    Chain,
    Line,
    Move,
    Sampled,
    TimeScaled,
    chord_lengths,
    rest_to_rest,
    smooth_step,
)
from aerotact.ports import Array
from aerotact.reference import Reference

STEP = 1e-4  # s, of the finite differences
START_P, START_Q = np.array([0.3, -0.2, 1.1]), np.array([0.5, -0.5, 0.5, 0.5])
END_P = np.array([1.3, 0.4, 0.9])
DERIVATIVES = ("v_WE_d", "w_E_d", "a_WE_d", "dw_E_d")


def _attitude(sample: dict[str, Array]) -> Rotation:
    return Rotation.from_quat(sample["q_WE_d"], scalar_first=True)


def _turned(angle: float, axis: tuple[float, float, float] = (0.6, 0.0, 0.8)) -> Array:
    turn = Rotation.from_quat(START_Q, scalar_first=True) * Rotation.from_rotvec(angle * np.array(axis))
    return np.asarray(turn.as_quat(scalar_first=True))


def _spline(at_rest: bool = False) -> Waypoints:
    points = np.array([[0, 0, 0], [0.2, 0.1, 0], [0.3, 0.4, 0.1], [0.1, 0.5, -0.1], [0, 0.3, 0]], float)
    turns = np.array([[0, 0, 0], [0.5, 0, 0], [0.8, 0.4, 0], [0, 1.0, 0.3], [-0.5, 0.2, 0]])
    return Waypoints(START_P, START_Q, list(chord_lengths(points)), points, turns, at_rest)


def _along(order: int) -> TimeScaled:
    path = _spline()
    return TimeScaled(path, (path._start, path._stop), 1.0, 5.0, order)


def check_derivatives(motion: Reference, times: Array) -> None:
    """Velocities and accelerations are those of the pose by central differences."""
    before, now, after = (motion.sample(times + shift) for shift in (-STEP, 0.0, STEP))
    v = (after["p_WE_d"] - before["p_WE_d"]) / (2 * STEP)
    a = (after["v_WE_d"] - before["v_WE_d"]) / (2 * STEP)
    w = (_attitude(before).inv() * _attitude(after)).as_rotvec() / (2 * STEP)
    dw = (after["w_E_d"] - before["w_E_d"]) / (2 * STEP)
    for name, expected in (("v_WE_d", v), ("a_WE_d", a), ("w_E_d", w), ("dw_E_d", dw)):
        np.testing.assert_allclose(now[name], expected, atol=2e-5 * max(1.0, np.abs(expected).max()), err_msg=name)
        assert np.abs(expected).max() > 0.05, name


@pytest.mark.parametrize("order", [5, 7])
def test_smooth_step_is_flat_at_both_ends(order: int) -> None:
    s, ds, dds = smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]), order)
    np.testing.assert_allclose(s, [0, 0, 0.5, 1, 1], atol=1e-14)
    np.testing.assert_allclose(ds[[0, 1, 3, 4]], 0.0, atol=1e-13)
    np.testing.assert_allclose(dds, 0.0, atol=1e-12)
    x = np.linspace(0.01, 0.99, 99)
    jerk = np.gradient(smooth_step(np.array([0.0, 1e-4, 2e-4]), order)[2], 1e-4)[0]
    assert (np.diff(smooth_step(x, order)[0]) > 0).all()
    assert jerk == pytest.approx(60.0 if order == 5 else 0.0, abs=0.2)


def test_other_orders_are_refused() -> None:
    with pytest.raises(InputError, match="order of a smooth step is 6; valid: 5, 7"):
        TimeScaled(Hold(START_P, START_Q), (0.0, 1.0), 0.0, 1.0, order=6)


@pytest.mark.parametrize("order", [5, 7])
@pytest.mark.parametrize("angle", [0.4, 3.0, np.pi, 4.0])
def test_move_between_poses_has_true_derivatives(order: int, angle: float) -> None:
    motion = rest_to_rest(START_P, START_Q, [Move(1.0, 3.0, END_P, _turned(angle))], order)
    check_derivatives(motion, np.linspace(1.01, 2.99, 300))


@pytest.mark.parametrize("order", [5, 7])
def test_spline_with_time_scaling_has_true_derivatives(order: int) -> None:
    check_derivatives(_along(order), np.linspace(1.01, 4.99, 400))


@pytest.mark.parametrize("motion", [_along(5), rest_to_rest(START_P, START_Q, [Move(1.0, 5.0, END_P, _turned(2.0))])])
def test_motion_starts_and_ends_at_rest(motion: Reference) -> None:
    sample = motion.sample(np.array([-3.0, 1.0, 1.0 + 1e-6, 5.0 - 1e-6, 5.0, 9.0]))
    for name in DERIVATIVES:
        np.testing.assert_allclose(sample[name], 0.0, atol=1e-4)
        np.testing.assert_allclose(sample[name][[0, 1, 4, 5]], 0.0, atol=1e-12)
    np.testing.assert_allclose(sample["p_WE_d"][:3], np.tile(START_P, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(np.ptp(sample["p_WE_d"][3:], axis=0), 0.0, atol=1e-9)


def test_spline_passes_through_its_points_at_an_even_speed() -> None:
    """A circle of 0.2 m in 16 chords: the speed along it is 1 in units of the chord lengths."""
    angles = np.linspace(0.0, 2 * np.pi, 17)
    points = 0.2 * np.column_stack([np.zeros(17), np.sin(angles), 1 - np.cos(angles)])
    lengths = chord_lengths(points)
    path = Waypoints(START_P, START_Q, list(lengths), points, np.zeros((17, 3)), at_rest=False)
    np.testing.assert_allclose(path.sample(lengths)["p_WE_d"], START_P + points, atol=1e-12)
    speed = np.linalg.norm(path.sample(np.linspace(1e-6, lengths[-1] - 1e-6, 500))["v_WE_d"], axis=1)
    np.testing.assert_allclose(speed[50:-50], 1.0, atol=0.01)
    np.testing.assert_allclose(speed, 1.0, atol=0.05)  # the natural ends
    once = TimeScaled(path, (0.0, lengths[-1]), 0.0, 10.0).sample(np.array([2.5, 5.0]))
    np.testing.assert_allclose(once["p_WE_d"][1], START_P + np.array([0, 0, 0.4]), atol=1e-9)
    assert np.linalg.norm(once["v_WE_d"][1]) == pytest.approx(1.875 * lengths[-1] / 10.0, rel=0.01)


@pytest.mark.parametrize("angle", [np.pi - 1e-6, np.pi, np.pi + 1e-6])
def test_half_turns_are_even_and_about_one_axis(angle: float) -> None:
    """At 180 degrees and on both sides of it: the ends are met, the rate's direction is constant, its integral pi."""
    motion = rest_to_rest(START_P, START_Q, [Move(0.0, 2.0, START_P, _turned(angle))])
    times = np.linspace(0.0, 2.0, 2001)
    sample = motion.sample(times)
    assert (_attitude(sample)[-1].inv() * Rotation.from_quat(_turned(angle), scalar_first=True)).magnitude() < 1e-9
    rate = np.linalg.norm(sample["w_E_d"], axis=1)
    assert np.trapezoid(rate, times) == pytest.approx(np.pi, abs=1e-5)
    axes = sample["w_E_d"][1:-1] / rate[1:-1, None]
    np.testing.assert_allclose(np.abs(axes @ [0.6, 0.0, 0.8]), 1.0, atol=1e-9)
    steps = (_attitude(sample)[:-1].inv() * _attitude(sample)[1:]).magnitude()
    assert steps.max() == pytest.approx(1.875 * np.pi / 2 * 1e-3, rel=1e-3)  # largest rate of a quintic


def test_full_turn_in_two_moves() -> None:
    moves = [Move(0.0, 1.0, START_P, _turned(2.5)), Move(1.0, 2.0, START_P, _turned(5.0))]
    sample = rest_to_rest(START_P, START_Q, moves).sample(np.linspace(0.0, 2.0, 401))
    way = (_attitude(sample)[:-1].inv() * _attitude(sample)[1:]).magnitude().sum()
    assert way == pytest.approx(5.0, abs=1e-9)


def test_chain_rests_between_moves_and_never_jumps() -> None:
    moves = [Move(1.0, 2.0, END_P, _turned(1.0)), Move(3.0, 4.5, START_P, START_Q)]
    motion = rest_to_rest(START_P, START_Q, moves)
    times = np.arange(0.0, 6.0, 1e-3)
    sample = motion.sample(times)
    assert not np.isnan(np.hstack(list(sample.values()))).any()
    resting = (times < 1.0) | ((times > 2.0) & (times < 3.0)) | (times > 4.5)
    for name in DERIVATIVES:
        np.testing.assert_allclose(sample[name][resting], 0.0, atol=1e-12)
    assert np.abs(np.diff(sample["p_WE_d"], axis=0)).max() < 2e-3
    assert np.abs(np.diff(sample["v_WE_d"], axis=0)).max() < 7e-3
    np.testing.assert_allclose(sample["p_WE_d"][2500], END_P, atol=1e-12)
    np.testing.assert_allclose(sample["p_WE_d"][-1], START_P, atol=1e-12)


def test_chain_joins_what_comes_in_any_order_of_times() -> None:
    chain = Chain([(0.0, Hold(START_P, START_Q)), (2.0, Hold(END_P, START_Q))])
    np.testing.assert_array_equal(
        chain.sample(np.array([3.0, -1.0, 2.0, 1.9]))["p_WE_d"], [END_P, START_P, END_P, START_P]
    )


def test_line_goes_straight_at_constant_velocity() -> None:
    line = Line(START_P, START_Q, END_P, _turned(1.2))
    sample = line.sample(np.array([0.0, 0.25, 1.0]))
    np.testing.assert_allclose(sample["p_WE_d"][1], 0.75 * START_P + 0.25 * END_P, atol=1e-15)
    np.testing.assert_allclose((_attitude(sample)[0].inv() * _attitude(sample)[1]).magnitude(), 0.3, atol=1e-12)
    np.testing.assert_allclose(sample["w_E_d"], np.tile(1.2 * np.array([0.6, 0, 0.8]), (3, 1)), atol=1e-12)


def test_set_points_hold_for_a_hundredth_of_a_second() -> None:
    times = np.arange(0.0, 6.0, 1e-3)
    motion = _along(5)
    held, smooth = Sampled(motion).sample(times), motion.sample(times)
    for name, values in held.items():
        np.testing.assert_allclose(values[::10], smooth[name][::10], atol=1e-9, err_msg=name)
        np.testing.assert_array_equal(values.reshape(600, 10, -1), np.repeat(values[::10, None], 10, axis=1))
    assert np.abs(held["p_WE_d"] - smooth["p_WE_d"]).max() > 1e-3


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TimeScaled(_spline(), (0, 1), 2.0, 2.0), "start 2 s and stop 2 s; valid: start < stop"),
        (lambda: Chain([]), "one or more, increasing"),
        (lambda: rest_to_rest(START_P, START_Q, []), "one or more, increasing"),
        (
            lambda: rest_to_rest(START_P, START_Q, [Move(0, 2, END_P, START_Q), Move(1, 3, END_P, START_Q)]),
            "starts at 1 s; valid: 2 s",
        ),
    ],
)
def test_impossible_times_are_refused(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]
