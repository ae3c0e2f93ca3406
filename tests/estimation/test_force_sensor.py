"""The force sensor of bodie2021: filter against SciPy, weight, tare and the tool's tip."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy import signal
from stepping import Runner, random_unit, rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.butterworth import butterworth
from aerotact.estimation.force_sensor import force_sensor, sensor_of
from aerotact.exceptions import MissingCapability
from aerotact.ports import Array, Block

RATE = 200.0


def _sensor(model: Model, cutoff: float = 5.0, rate: float = RATE) -> Block:
    return force_sensor(model, rate).with_parameters({"force_cutoff": cutoff})


def _reading(model: Model, q_WB: Array, f_B: Array, tau_B: Array) -> dict[str, Array]:
    """What the sensor says at rest while the tool exerts f_B, and tau_B about its tip, on the environment."""
    sensor = sensor_of(model)
    R_BS, R_WB = sensor.R_BS, rotation(q_WB)
    lift_B = R_WB.T @ [0, 0, sensor.distal_mass * model.robot.gravity]
    lever_E, lever_D = model.robot.p_BE - sensor.p_BS, R_BS @ sensor.p_SD
    tau = tau_B + np.cross(lever_E, f_B) + np.cross(lever_D, lift_B)
    return {"q_WB": q_WB, "f_sensor_S": R_BS.T @ (f_B + lift_B), "tau_sensor_S": R_BS.T @ tau}


@pytest.mark.parametrize(("cutoff", "rate"), [(5.0, 200.0), (5.0, 500.0), (40.0, 200.0), (80.0, 200.0)])
def test_coefficients_are_those_of_scipy(cutoff: float, rate: float) -> None:
    b, a = butterworth(ca.DM(cutoff), rate)
    wanted = signal.butter(2, cutoff, fs=rate)
    np.testing.assert_allclose(b.full().ravel(), wanted[0], rtol=1e-9)
    np.testing.assert_allclose(a.full().ravel(), wanted[1], rtol=1e-9)


def test_response_is_that_of_scipy_from_rest(tilting: Model) -> None:
    rng = np.random.default_rng(4)
    wrench = rng.normal(size=(400, 6)).cumsum(axis=0)
    q, run = np.array([1.0, 0, 0, 0]), Runner(_sensor(tilting))
    found = []
    for row in wrench:
        out = run(_reading(tilting, q, row[:3], row[3:]))
        found.append(np.concatenate([out["f_push_B"], out["tau_push_B"]]))
    b, a = signal.butter(2, 5.0, fs=RATE)
    wanted, _ = signal.lfilter(b, a, wrench, axis=0, zi=np.outer(signal.lfilter_zi(b, a), wrench[0]))
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_weight_is_taken_off_at_any_attitude(tilting: Model) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        q, f, tau = random_unit(rng), rng.normal(size=3), rng.normal(size=3)
        out = Runner(_sensor(tilting))(_reading(tilting, q, f, tau))
        np.testing.assert_allclose(out["f_push_B"], f, atol=1e-9)
        np.testing.assert_allclose(out["tau_push_B"], tau, atol=1e-9)


def test_tare_is_the_mean_while_calibrating_and_each_rise_begins_anew(tilting: Model) -> None:
    rng, q = np.random.default_rng(6), np.array([1.0, 0, 0, 0])
    bias, run = np.array([0.3, -0.2, 0.1]), Runner(_sensor(tilting))
    y = _reading(tilting, q, np.zeros(3), np.zeros(3))

    def sample(bias: Array, calibrate: float) -> Array:
        noisy = y["f_sensor_S"] + bias + 0.05 * rng.normal(size=3)
        return run({**y, "f_sensor_S": noisy}, {"calibrate": [calibrate]})["f_push_B"]

    def rest(bias: Array) -> Array:
        return np.mean([sample(bias, 0.0) for _ in range(400)][-200:], axis=0)

    for _ in range(1000):
        sample(bias, 1.0)
    assert np.abs(rest(bias)).max() < 0.01
    drifted = bias + 0.5
    off = rest(drifted)
    np.testing.assert_allclose(off, sensor_of(tilting).R_BS @ np.full(3, 0.5), atol=0.02)
    for _ in range(1000):
        sample(drifted, 1.0)
    assert np.abs(rest(drifted)).max() < 0.01


def test_robot_without_the_sensor_is_told_so(tilting: Model) -> None:
    blind = Model(replace(tilting.robot, force_torque=None))
    with pytest.raises(MissingCapability, match="force_torque"):
        force_sensor(blind, RATE)
    with pytest.raises(MissingCapability, match="force_torque"):
        sensor_of(blind)
