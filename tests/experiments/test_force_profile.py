"""Force ramps: sinusoidal, continuous with their rate, 80 % of a contact at the desired force."""

import numpy as np
import pytest

from aerotact.exceptions import InputError
from aerotact.experiments.force_profile import ForceProfile, Ramp, press
from aerotact.experiments.reference import Hold, Together


def test_contact_holds_its_force_for_80_percent_of_its_time() -> None:
    profile = ForceProfile(press(2.0, 7.0, 10.0))
    times = np.arange(0.0, 10.0, 1e-3)
    force = profile.sample(times)["f_ref"]
    assert force.shape == (10000, 1)
    assert (np.abs(force - 10.0) < 1e-12).mean() == pytest.approx(0.4, abs=1e-3)
    assert np.abs(force[(times <= 2.0) | (times >= 7.0)]).max() < 1e-12
    assert profile.sample(np.array([2.25]))["f_ref"] == pytest.approx(5.0, abs=1e-12)
    assert profile.sample(np.array([2.125]))["f_ref"] == pytest.approx(5.0 * (1 - np.sqrt(0.5)), abs=1e-12)


def test_force_and_its_rate_are_continuous() -> None:
    """Steps of force and rate shrink with the step of time."""
    profile = ForceProfile([Ramp(1.0, 2.0, 5.0), Ramp(2.0, 2.5, 12.0), *press(4.0, 6.0, 3.0)])
    largest = []
    for step in (1e-3, 1e-4):
        force = profile.sample(np.arange(0.0, 7.0, step))["f_ref"][:, 0]
        rate = np.diff(force) / step
        largest.append([np.abs(np.diff(force)).max(), np.abs(np.diff(rate)).max()])
    coarse, fine = np.array(largest)
    np.testing.assert_allclose(fine, coarse / 10, rtol=0.02)
    assert coarse[0] == pytest.approx(9.0 * np.pi / 2 / 0.2 * 1e-3, rel=1e-3)  # from 12 N to 3 N in 0.2 s


def test_ramps_go_from_one_force_to_the_next() -> None:
    profile = ForceProfile([Ramp(1.0, 2.0, 5.0), Ramp(3.0, 4.0, 20.0), Ramp(5.0, 6.0, 1.0)])
    np.testing.assert_allclose(
        profile.sample(np.array([0.0, 1.0, 2.5, 3.5, 4.5, 9.0]))["f_ref"][:, 0], [0, 0, 5, 12.5, 20, 1], atol=1e-12
    )


def test_profile_flies_beside_a_motion() -> None:
    both = Together([Hold(np.zeros(3), np.array([1.0, 0, 0, 0])), ForceProfile(press(0.0, 1.0, 5.0))])
    sample = both.sample(np.array([0.5, 2.0]))
    np.testing.assert_allclose(sample["f_ref"], [[5.0], [0.0]], atol=1e-12)
    assert sample["p_WE_d"].shape == (2, 3)


@pytest.mark.parametrize("ramps", [[Ramp(1.0, 1.0, 5.0)], [Ramp(1.0, 2.0, 5.0), Ramp(1.5, 3.0, 0.0)]])
def test_impossible_ramps_are_refused(ramps: list[Ramp]) -> None:
    with pytest.raises(InputError, match="valid: start < stop, after"):
        ForceProfile(ramps)
