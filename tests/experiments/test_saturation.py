"""Saturation: weak rotors, a pitched body, a side wind; the MPC gives what it can and keeps its attitude."""

import numpy as np
import pytest

from aerotact.experiments.bodie2021.saturation import JUDGED, PUSH, RAMP, THRUST, Saturation, attitude_error, weak_robot
from aerotact.flight import fly
from aerotact.metrics import push_force
from aerotact.robot import load_robot

SATURATION = Saturation()


def test_the_weak_robot_differs_in_its_range_of_thrust_alone() -> None:
    weak, strong = load_robot(weak_robot()), load_robot("tilt_rotor")
    assert {r.thrust[1] for r in weak.rotors} == {THRUST}
    assert {r.thrust[0] for r in weak.rotors} == {r.thrust[0] for r in strong.rotors}
    assert weak.mass == strong.mass
    np.testing.assert_array_equal(weak.J_C, strong.J_C)


def test_the_mpc_keeps_contact_attitude_and_limits() -> None:
    log, result = fly(SATURATION, SATURATION.cases[0], "mpc", 0)
    assert result.fault == ""
    windy = log.window(*JUDGED)
    force = push_force(log.columns)[windy]
    assert (force > 0).all()
    assert force.mean() == pytest.approx(PUSH, abs=0.5)
    assert np.rad2deg(attitude_error(log.columns)[log.window(RAMP[0], JUDGED[1])].max()) < 5.0
    assert log["thrust"].max() > 0.95 * THRUST  # or nothing was saturated
    for limit in ("thrust", "thrust_rate", "tilt", "tilt_rate"):
        assert result.metrics[f"violations_{limit}"].value == 0
