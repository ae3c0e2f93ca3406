"""The error-state filter on a known flight with noise and bias: accuracy, consistency, start-up, covariance."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import Runner, run_through

from aerotact.dynamics.model import Model
from aerotact.estimation.state_estimator import state_estimator
from aerotact.exceptions import RobotError
from aerotact.ports import Array
from aerotact.robot import Quantity

RATE, MOCAP_EVERY = 500.0, 5


@dataclass
class Recording:
    """A smooth known motion and what its sensors said; arrays have one row a sample."""

    p_WB: Array
    attitude: Rotation
    v_WB: Array
    w_B: Array
    measurement: Array
    accelerometer_bias: Array
    gyro_bias: Array


def _record(model: Model, seconds: float, seed: int) -> Recording:
    robot, rng = model.robot, np.random.default_rng(seed)
    sensors = robot.file.sensors
    n = int(seconds * RATE)
    t = np.arange(n)[:, None] / RATE
    size, frequency = np.array([0.5, 0.3, 0.2]), np.array([1.1, 1.7, 0.9])
    p = size * np.sin(frequency * t)
    v = size * frequency * np.cos(frequency * t)
    a = -size * frequency**2 * np.sin(frequency * t)
    w = np.array([0.4, 0.3, 0.5]) * np.cos(np.array([1.3, 0.9, 0.6]) * t)
    dw = np.array([-0.52, -0.27, -0.3]) * np.sin(np.array([1.3, 0.9, 0.6]) * t)
    middle = np.array([0.4, 0.3, 0.5]) * np.cos(np.array([1.3, 0.9, 0.6]) * (t[1:] - 0.5 / RATE))
    turns = [Rotation.from_rotvec([0.1, -0.05, 0.3])]
    for step in middle / RATE:
        turns.append(turns[-1] * Rotation.from_rotvec(step))
    attitude = Rotation.concatenate(turns)
    force = attitude.inv().apply(a + np.array([0, 0, robot.gravity]))
    force += np.cross(dw, robot.p_BI) + np.cross(w, np.cross(w, robot.p_BI))
    accelerometer_bias = sensors.imu.accelerometer_bias.array * rng.normal(size=3)
    gyro_bias = sensors.imu.gyro_bias.array * rng.normal(size=3)
    accelerometer = force + accelerometer_bias + sensors.imu.accelerometer_noise.array * rng.normal(size=(n, 3))
    gyro = w + gyro_bias + sensors.imu.gyro_noise.array * rng.normal(size=(n, 3))
    mocap_p = p + sensors.motion_capture.position_noise.array * rng.normal(size=(n, 3))
    noise = Rotation.from_rotvec(sensors.motion_capture.attitude_noise.array * rng.normal(size=(n, 3)))
    mocap_q = (attitude * noise).as_quat(scalar_first=True) * rng.choice([-1.0, 1.0], size=(n, 1))
    fresh = (np.arange(n) % MOCAP_EVERY == 0).astype(float)[:, None]
    held = np.arange(n) // MOCAP_EVERY * MOCAP_EVERY
    measurement = np.hstack([accelerometer, gyro, mocap_p[held], mocap_q[held], fresh])
    return Recording(p, attitude, v, w, measurement, accelerometer_bias, gyro_bias)


def _run(model: Model, record: Recording) -> tuple[dict[str, Array], dict[str, Array]]:
    """States and outputs by name, one row a sample."""
    block = state_estimator(model, RATE)
    ports = ["accelerometer_B", "gyro_B", "mocap_p_WB", "mocap_q_WB", "mocap_fresh"]
    assert [p.name for p in block.measurement] == ports
    return run_through(block, record.measurement)


def _rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def flight(model: Model) -> tuple[Recording, dict[str, Array], dict[str, Array]]:
    record = _record(model, 60.0, seed=21)
    return record, *_run(model, record)


def test_errors_in_flight(flight: tuple[Recording, dict[str, Array], dict[str, Array]]) -> None:
    record, _, out = flight
    settled = slice(int(2 * RATE), None)
    assert _rms((out["p_WB"] - record.p_WB)[settled]) < 1e-3
    assert _rms((out["v_WB"] - record.v_WB)[settled]) < 0.01
    turn = record.attitude.inv() * Rotation.from_quat(out["q_WB"], scalar_first=True)
    assert np.degrees(_rms(turn.as_rotvec()[settled])) < 0.2
    assert np.abs((out["w_B"] - record.w_B)[settled].mean(axis=0)).max() < 1e-3


def test_biases_are_found(flight: tuple[Recording, dict[str, Array], dict[str, Array]]) -> None:
    record, states, _ = flight
    assert np.abs(states["gyro_bias_B"][-1] - record.gyro_bias).max() < 5e-4
    assert np.abs(states["accelerometer_bias_B"][-1] - record.accelerometer_bias).max() < 0.02
    assert np.linalg.norm(record.accelerometer_bias) > 0.02


def test_covariance_stays_positive_definite_and_honest(
    flight: tuple[Recording, dict[str, Array], dict[str, Array]],
) -> None:
    record, states, _ = flight
    upper = [(i, j) for j in range(15) for i in range(j + 1)]
    squares = []
    for k in range(int(5 * RATE), len(record.p_WB), 250):
        P = np.zeros((15, 15))
        for value, (i, j) in zip(states["covariance"][k], upper, strict=True):
            P[i, j] = P[j, i] = value
        scaled = P / np.sqrt(np.outer(np.diag(P), np.diag(P)))
        assert np.linalg.eigvalsh(scaled).min() > 1e-6
        turn = Rotation.from_quat(states["q_WB"][k], scalar_first=True).inv() * record.attitude[k]
        bias = record.gyro_bias - states["gyro_bias_B"][k]
        error = np.concatenate([turn.as_rotvec(), bias])
        where = [3, 4, 5, 9, 10, 11]
        squares.append(error @ np.linalg.solve(P[np.ix_(where, where)], error))
    assert len(squares) > 100
    assert 2 < np.mean(squares) < 12, "six numbers: about 6 if the covariance tells the truth"


def test_waits_for_motion_capture(model: Model) -> None:
    run = Runner(state_estimator(model, RATE))
    y = {"mocap_p_WB": [1.0, 2.0, 3.0], "mocap_q_WB": [0.8, 0.0, 0.6, 0.0], "gyro_B": [0.0, 0.0, 0.0]}
    for _ in range(20):
        out = run({**y, "mocap_fresh": 0.0})
        np.testing.assert_array_equal(out["q_WB"], [1, 0, 0, 0])
        np.testing.assert_array_equal(out["v_WB"], [0, 0, 0])
    out = run({**y, "mocap_fresh": 1.0})
    np.testing.assert_allclose(out["p_WB"], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(out["q_WB"], [0.8, 0, 0.6, 0], atol=1e-12)


def test_stale_motion_capture_is_not_used(model: Model) -> None:
    run = Runner(state_estimator(model, RATE))
    run({"mocap_fresh": 1.0})
    for _ in range(100):
        out = run({"mocap_p_WB": [5.0, 5.0, 5.0], "mocap_fresh": 0.0})
    np.testing.assert_allclose(out["p_WB"], np.zeros(3), atol=1e-9)


def test_size_of_the_function(model: Model) -> None:
    assert state_estimator(model, RATE).step.n_instructions() < 15_000


def test_wrong_unit_of_a_sensor_is_refused(hexarotor: Model) -> None:
    robot = hexarotor.robot
    imu = robot.file.sensors.imu.model_copy(update={"gyro_noise": Quantity(value=0.2, unit="deg/s", source="assumed")})
    sensors = robot.file.sensors.model_copy(update={"imu": imu})
    file = robot.file.model_copy(update={"sensors": sensors})
    with pytest.raises(RobotError, match=r"sensors\.imu\.gyro_noise: unit is 'deg/s'; give it in 'rad/s'"):
        state_estimator(Model(replace(robot, file=file)), RATE)
