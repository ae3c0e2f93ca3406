"""The error-state filter on a known flight with noise and bias: accuracy, consistency, start-up, covariance."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import Runner, random_unit, rotation, run_through

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.estimation.state_estimator import Noise, Nominal, observation, predict, state_estimator, transition
from aerotact.exceptions import RobotError
from aerotact.ports import Array
from aerotact.robot_file import Quantity

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


def _record(model: Model, seconds: float, seed: int, noise: float = 1.0) -> Recording:
    """A flight from rest; `noise` scales every noise and bias of robot.toml."""
    robot, rng = model.robot, np.random.default_rng(seed)
    sensors = robot.file.sensors
    n = int(seconds * RATE)
    t = np.arange(n)[:, None] / RATE
    size, frequency = np.array([0.5, 0.3, 0.2]), np.array([1.1, 1.7, 0.9])
    p = size * (1 - np.cos(frequency * t))
    v = size * frequency * np.sin(frequency * t)
    a = size * frequency**2 * np.cos(frequency * t)
    swing, pace = np.array([0.4, 0.3, 0.5]), np.array([1.3, 0.9, 0.6])
    w = swing * np.sin(pace * t)
    dw = swing * pace * np.cos(pace * t)
    middle = swing * np.sin(pace * (t[1:] - 0.5 / RATE))
    turns = [Rotation.from_rotvec([0.1, -0.05, 0.3])]
    for step in middle / RATE:
        turns.append(turns[-1] * Rotation.from_rotvec(step))
    attitude = Rotation.concatenate(turns)
    force = attitude.inv().apply(a + np.array([0, 0, robot.gravity]))
    force += np.cross(dw, robot.p_BI) + np.cross(w, np.cross(w, robot.p_BI))
    imu, mocap = sensors.imu, sensors.motion_capture

    def draw(level: Quantity, *shape: int) -> Array:
        return noise * level.array * rng.normal(size=shape)

    accelerometer_bias, gyro_bias = draw(imu.accelerometer_bias, 3), draw(imu.gyro_bias, 3)
    accelerometer = force + accelerometer_bias + draw(imu.accelerometer_noise, n, 3)
    gyro = w + gyro_bias + draw(imu.gyro_noise, n, 3)
    mocap_p = p + draw(mocap.position_noise, n, 3)
    seen = attitude * Rotation.from_rotvec(draw(mocap.attitude_noise, n, 3))
    mocap_q = seen.as_quat(scalar_first=True) * rng.choice([-1.0, 1.0], size=(n, 1))
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
    assert _rms((out["p_WB"] - record.p_WB)[settled]) < 6e-4
    assert _rms((out["v_WB"] - record.v_WB)[settled]) < 6e-3
    turn = record.attitude.inv() * Rotation.from_quat(out["q_WB"], scalar_first=True)
    assert np.degrees(_rms(turn.as_rotvec()[settled])) < 0.06
    assert np.abs((out["w_B"] - record.w_B)[settled].mean(axis=0)).max() < 1e-3


def test_biases_are_found(flight: tuple[Recording, dict[str, Array], dict[str, Array]]) -> None:
    record, states, _ = flight
    assert np.abs(states["gyro_bias_B"][-1] - record.gyro_bias).max() < 3e-4
    assert np.abs(states["accelerometer_bias_B"][-1] - record.accelerometer_bias).max() < 0.01
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


def test_dead_reckoning_without_noise(model: Model) -> None:
    """One motion-capture sample at rest, then two seconds on perfect inertial samples: only the integration errs."""
    record = _record(model, 2.0, seed=22, noise=0.0)
    record.measurement[1:, -1] = 0.0
    _, out = run_through(state_estimator(model, RATE), record.measurement)
    assert np.abs(out["p_WB"] - record.p_WB).max() < 1e-5
    assert np.abs(out["v_WB"] - record.v_WB).max() < 2e-5
    turn = record.attitude.inv() * Rotation.from_quat(out["q_WB"], scalar_first=True)
    assert np.abs(turn.as_rotvec()).max() < 2e-6


def _disturbed(x: Array, error: Array) -> tuple[Array, Array, Array, Array, Array]:
    """p_WI, q_WB, v_WI and the biases of x (16,) changed by an error (15,)."""
    q = so3.product(ca.DM(x[3:7]), so3.exponential(ca.DM(error[3:6]))).full().ravel()
    return x[0:3] + error[0:3], q, x[7:10] + error[6:9], x[10:13] + error[9:12], x[13:16] + error[12:15]


def test_transition_and_observation_by_finite_differences(model: Model) -> None:
    rng, step, h = np.random.default_rng(23), 1e-6, 2e-3
    x = np.concatenate([rng.normal(size=3), random_unit(rng), rng.normal(size=9)])
    force, w, p_BI = rng.normal(0, 10, size=3), rng.normal(size=3), model.robot.p_BI + np.array([0.1, -0.2, 0.3])
    noise = Noise(*[ca.DM(0.1)] * 9)
    zero = ca.DM.zeros(15, 15)

    def after(error: Array) -> Array:
        state = Nominal(*(ca.DM(v) for v in _disturbed(x, error)), zero)
        moved = predict(state, noise, force - state.accelerometer_bias, w - state.gyro_bias, 9.81, h)
        return ca.evalf(moved.flat[:16]).full().ravel()

    def seen(error: Array) -> Array:
        p, q, *_ = _disturbed(x, error)
        turn = so3.local(ca.DM(x[3:7]), ca.DM(q)).full().ravel()
        return np.concatenate([p - rotation(q) @ p_BI, turn])

    F_columns, H_columns = [], []
    for e in np.eye(15):
        plus, minus = after(step * e), after(-step * e)
        turn = so3.local(ca.DM(minus[3:7]), ca.DM(plus[3:7])).full().ravel()
        difference = plus - minus
        F_columns.append(np.concatenate([difference[0:3], turn, difference[7:16]]) / (2 * step))
        H_columns.append((seen(step * e) - seen(-step * e)) / (2 * step))
    bare, free = force - x[13:16], w - x[10:13]
    middle = so3.product(ca.DM(x[3:7]), so3.exponential(ca.DM(h / 2 * free)))
    F = ca.evalf(transition(so3.rotation(middle), ca.DM(bare), ca.DM(free), h)).full()
    H = ca.evalf(observation(ca.DM(rotation(x[3:7])), ca.DM(p_BI))).full()
    np.testing.assert_allclose(F, np.array(F_columns).T, atol=1e-4)
    np.testing.assert_allclose(H, np.array(H_columns).T, atol=1e-5)


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
