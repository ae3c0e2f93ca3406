"""state_estimator: pose, velocity and inertial biases from an IMU and slower motion capture.

An error-state Kalman filter: the nominal attitude is a quaternion, its error a small rotation vector in the body's own
axes (so that no constraint enters the covariance). It stands in for the unscented filter of ryll2019 ('Hardware': IMU
at 500 Hz, motion capture at 100 Hz), which the paper names but does not specify.

Position and velocity are those of the IMU, so that its lever arm needs no angular acceleration; the outputs are moved
to the base's origin. Error coordinates: dp_W, dtheta_B, dv_W, gyroscope bias, accelerometer bias; 15 numbers.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.exceptions import RobotError
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder
from aerotact.robot import Robot
from aerotact.robot_file import Quantity

ERRORS = 15
SMALLEST = 1e-6  # of a standard deviation, in its unit: a perfect sensor would leave nothing to invert
POSITION, ATTITUDE, VELOCITY, GYRO_BIAS, ACCELEROMETER_BIAS = (slice(i, i + 3) for i in range(0, ERRORS, 3))
_UPPER = [(i, j) for j in range(ERRORS) for i in range(j + 1)]


@dataclass(frozen=True)
class Nominal:
    """Nominal state: p_WI m, q_WB, v_WI m/s, gyro_bias rad/s, accelerometer_bias m/s2; P, the errors' covariance."""

    p_WI: Any
    q_WB: Any
    v_WI: Any
    gyro_bias: Any
    accelerometer_bias: Any
    P: Any

    @property
    def flat(self) -> Any:
        """All numbers in one column; of P its upper triangle."""
        upper = ca.vertcat(*[self.P[i, j] for i, j in _UPPER])
        return ca.vertcat(self.p_WI, self.q_WB, self.v_WI, self.gyro_bias, self.accelerometer_bias, upper)

    @classmethod
    def of(cls, flat: Any) -> "Nominal":
        """Inverse of `flat`."""
        P = ca.SX(ERRORS, ERRORS)
        for k, (i, j) in enumerate(_UPPER):
            P[i, j] = P[j, i] = flat[16 + k]
        return cls(flat[0:3], flat[3:7], flat[7:10], flat[10:13], flat[13:16], P)


@dataclass(frozen=True)
class Noise:
    """Standard deviations, each a scalar.

    Attributes:
        accelerometer, gyro: of a sample, m/s2 and rad/s.
        accelerometer_walk, gyro_walk: of the biases' change in a second, m/s2/s^0.5 and rad/s/s^0.5.
        mocap_position, mocap_attitude: of a sample, m and rad.
        accelerometer_bias, gyro_bias, velocity: at the start, m/s2, rad/s and m/s.
    """

    accelerometer: Any
    gyro: Any
    accelerometer_walk: Any
    gyro_walk: Any
    mocap_position: Any
    mocap_attitude: Any
    accelerometer_bias: Any
    gyro_bias: Any
    velocity: Any


def initialise(p_BI: Any, noise: Noise, p_WB: Any, q_WB: Any) -> Nominal:
    """State from one motion-capture sample: at rest, without bias, as uncertain as `noise` says."""
    deviations = [noise.mocap_position, noise.mocap_attitude, noise.velocity, noise.gyro_bias, noise.accelerometer_bias]
    P = ca.diag(ca.vertcat(*[ca.repmat(s * s, 3, 1) for s in deviations]))
    zero = ca.SX.zeros(3)
    return Nominal(p_WB + ca.mtimes(so3.rotation(q_WB), p_BI), q_WB, zero, zero, zero, P)


def transition(R_WB: Any, specific_force_B: Any, w_B: Any, h: float) -> Any:
    """Matrix (15, 15) that carries the errors over h seconds, to first order in h.

    Args:
        R_WB: attitude in the middle of the step.
        specific_force_B: m/s2, free of bias.
        w_B: rad/s, free of bias.
        h: s.
    """
    F = ca.SX.eye(ERRORS)
    F[POSITION, VELOCITY] = h * ca.SX.eye(3)
    F[ATTITUDE, ATTITUDE] = so3.rotation(so3.exponential(-h * w_B))
    F[ATTITUDE, GYRO_BIAS] = -h * ca.SX.eye(3)
    F[VELOCITY, ATTITUDE] = -h * ca.mtimes(R_WB, so3.skew(specific_force_B))
    F[VELOCITY, ACCELEROMETER_BIAS] = -h * R_WB
    return F


def observation(R_WB: Any, p_BI: Any) -> Any:
    """Matrix (6, 15) from the errors to those of motion capture's position, m in W, and attitude, rad in B."""
    H = ca.SX(6, ERRORS)
    H[0:3, POSITION] = ca.SX.eye(3)
    H[0:3, ATTITUDE] = ca.mtimes(R_WB, so3.skew(p_BI))  # p_WB = p_WI - R_WB exp([dtheta]x) p_BI
    H[3:6, ATTITUDE] = ca.SX.eye(3)
    return H


def predict(state: Nominal, noise: Noise, specific_force_B: Any, w_B: Any, gravity: float, h: float) -> Nominal:
    """State h seconds later, with specific force, m/s2, and angular velocity, rad/s, free of bias and held."""
    half_turn = so3.product(state.q_WB, so3.exponential(h / 2 * w_B))
    q_WB = so3.unit(so3.product(state.q_WB, so3.exponential(h * w_B)))
    R_WB = so3.rotation(half_turn)
    a_WI = ca.mtimes(R_WB, specific_force_B) - ca.DM([0, 0, gravity])

    F = transition(R_WB, specific_force_B, w_B, h)
    added = [
        ca.SX.zeros(3),
        ca.repmat((h * noise.gyro) ** 2, 3, 1),
        ca.repmat((h * noise.accelerometer) ** 2, 3, 1),
        ca.repmat(h * noise.gyro_walk**2, 3, 1),
        ca.repmat(h * noise.accelerometer_walk**2, 3, 1),
    ]
    P = ca.mtimes(ca.mtimes(F, state.P), F.T) + ca.diag(ca.vertcat(*added))
    return Nominal(
        p_WI=state.p_WI + h * state.v_WI + h * h / 2 * a_WI,
        q_WB=q_WB,
        v_WI=state.v_WI + h * a_WI,
        gyro_bias=state.gyro_bias,
        accelerometer_bias=state.accelerometer_bias,
        P=P,
    )


def correct(state: Nominal, noise: Noise, p_BI: Any, p_WB: Any, q_WB: Any) -> Nominal:
    """State after a motion-capture sample of the base: six scalar updates, so that nothing is inverted."""
    R_WB = so3.rotation(state.q_WB)
    H = observation(R_WB, p_BI)
    residual = ca.vertcat(p_WB - (state.p_WI - ca.mtimes(R_WB, p_BI)), so3.local(state.q_WB, q_WB))
    variance = ca.vertcat(
        ca.repmat(noise.mocap_position**2, 3, 1),
        ca.repmat(noise.mocap_attitude**2, 3, 1),
    )
    P, error = state.P, ca.SX.zeros(ERRORS)
    for row in range(6):
        PH = ca.mtimes(P, H[row, :].T)
        scale = ca.mtimes(H[row, :], PH) + variance[row]
        error = error + PH * (residual[row] - ca.mtimes(H[row, :], error)) / scale
        P = P - ca.mtimes(PH, PH.T) / scale
    return Nominal(
        p_WI=state.p_WI + error[POSITION],
        q_WB=so3.unit(so3.product(state.q_WB, so3.exponential(error[ATTITUDE]))),
        v_WI=state.v_WI + error[VELOCITY],
        gyro_bias=state.gyro_bias + error[GYRO_BIAS],
        accelerometer_bias=state.accelerometer_bias + error[ACCELEROMETER_BIAS],
        P=P,
    )


def _choose(condition: Any, yes: Nominal, no: Nominal) -> Nominal:
    return Nominal.of(ca.if_else(condition, yes.flat, no.flat))


def _deviation(robot: Robot, sensor: str, key: str, quantity: Quantity, unit: str) -> float:
    """The largest component of a sensor's standard deviation, at least `SMALLEST`.

    Raises:
        RobotError: another unit, or a value below zero.
    """
    file, part = robot.folder / "robot.toml", f"sensors.{sensor}.{key}"
    if quantity.unit != unit:
        raise RobotError(file, part, f"unit is '{quantity.unit}'", f"give it in '{unit}'")
    value = float(quantity.array.max())
    if not value >= 0:
        raise RobotError(file, part, f"is {quantity.value}", "give a standard deviation >= 0")
    return max(value, SMALLEST)


def _add_noise(b: BlockBuilder, robot: Robot) -> Noise:
    """Parameters, by default those of the robot's sensors; the biases' walk is assumed."""
    imu, mocap = robot.file.sensors.imu, robot.file.sensors.motion_capture

    def of_imu(key: str, quantity: Quantity, unit: str, doc: str) -> Any:
        return b.parameter(key, 1, unit, _deviation(robot, "imu", key, quantity, unit), doc=doc)

    def of_mocap(key: str, quantity: Quantity, unit: str, doc: str) -> Any:
        value = _deviation(robot, "motion_capture", key, quantity, unit)
        return b.parameter(f"mocap_{key}", 1, unit, value, doc=doc)

    return Noise(
        accelerometer=of_imu("accelerometer_noise", imu.accelerometer_noise, "m/s^2", "deviation of a sample"),
        gyro=of_imu("gyro_noise", imu.gyro_noise, "rad/s", "deviation of a sample"),
        accelerometer_walk=b.parameter("accelerometer_walk", 1, "m/s2/s^0.5", 1e-3, doc="walk of the bias, assumed"),
        gyro_walk=b.parameter("gyro_walk", 1, "rad/s/s^0.5", 1e-4, doc="walk of the bias, assumed"),
        mocap_position=of_mocap("position_noise", mocap.position_noise, "m", "deviation of a sample"),
        mocap_attitude=of_mocap("attitude_noise", mocap.attitude_noise, "rad", "deviation of a sample"),
        accelerometer_bias=of_imu("accelerometer_bias", imu.accelerometer_bias, "m/s^2", "deviation of the bias"),
        gyro_bias=of_imu("gyro_bias", imu.gyro_bias, "rad/s", "deviation of the bias"),
        velocity=b.parameter("velocity_start", 1, "m/s", 0.1, doc="deviation of the velocity at the start, assumed"),
    )


def state_estimator(model: Model, rate: float) -> Block:
    """Error-state Kalman filter at `rate` Hz, the IMU's; motion capture enters when `mocap_fresh` is 1.

    It starts at the first fresh motion-capture sample; until then pose and velocity are their defaults and the inertial
    samples pass unchanged. Each prediction uses the mean of the two samples at its ends.

    Raises:
        RobotError: a sensor's deviation has the wrong unit or is below zero.
    """
    robot, h = model.robot, 1.0 / rate
    p_BI = ca.sparsify(ca.DM(robot.p_BI))
    rest = (0.0, 0.0, robot.gravity)
    b = BlockBuilder("state_estimator", "aerotact", rate, "error-state Kalman filter of IMU and motion capture")
    started = b.state("started", 1, "1", kind="flag", doc="1 after the first motion-capture sample")
    accelerometer_before = b.state("accelerometer_B", 3, "m/s^2", frame="B", doc="sample before", default=rest)
    gyro_before = b.state("gyro_B", 3, "rad/s", frame="B", doc="sample before")
    names = ("p_WI", "q_WB", "v_WI", "gyro_bias_B", "accelerometer_bias_B", "covariance")
    now = Nominal.of(
        ca.vertcat(
            b.state("p_WI", 3, "m", frame="W", doc="position of the IMU"),
            b.state("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion"),
            b.state("v_WI", 3, "m/s", frame="W", doc="velocity of the IMU"),
            b.state("gyro_bias_B", 3, "rad/s", frame="B", doc="bias of the gyroscope"),
            b.state("accelerometer_bias_B", 3, "m/s^2", frame="B", doc="bias of the accelerometer"),
            b.state("covariance", len(_UPPER), "1", doc="upper triangle, column by column, of the errors' covariance"),
        )
    )
    accelerometer = b.measurement(
        "accelerometer_B", 3, "m/s^2", frame="B", doc="specific force of the IMU", default=rest
    )
    gyro = b.measurement("gyro_B", 3, "rad/s", frame="B", doc="angular velocity")
    mocap_p = b.measurement("mocap_p_WB", 3, "m", frame="W", doc="position of the base by motion capture")
    mocap_q = b.measurement("mocap_q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion")
    fresh = b.measurement("mocap_fresh", 1, "1", kind="flag", doc="1 if the motion-capture sample is new") > 0
    noise = _add_noise(b, robot)

    force_B = (accelerometer_before + accelerometer) / 2 - now.accelerometer_bias
    w_mean = (gyro_before + gyro) / 2 - now.gyro_bias
    moved = predict(now, noise, force_B, w_mean, robot.gravity, h)
    running = _choose(fresh, correct(moved, noise, p_BI, mocap_p, mocap_q), moved)
    begun = _choose(fresh, initialise(p_BI, noise, mocap_p, mocap_q), now)
    after = _choose(started > 0, running, begun)

    b.update("started", ca.if_else(fresh, 1, started))
    b.update("accelerometer_B", accelerometer)
    b.update("gyro_B", gyro)
    flat, start = after.flat, 0
    for name, size in zip(names, (3, 4, 3, 3, 3, len(_UPPER)), strict=True):
        b.update(name, flat[start : start + size])
        start += size

    R_WB, w_B = so3.rotation(after.q_WB), gyro - after.gyro_bias
    b.output("p_WB", after.p_WI - ca.mtimes(R_WB, p_BI), "m", frame="W", doc="position of the base")
    b.output("q_WB", after.q_WB, "1", frame="W", doc="attitude of the base", kind="quaternion")
    b.output("v_WB", after.v_WI - ca.mtimes(R_WB, ca.cross(w_B, p_BI)), "m/s", frame="W", doc="velocity of the base")
    b.output("w_B", w_B, "rad/s", frame="B", doc="angular velocity, bias removed")
    b.output(
        "specific_force_B", accelerometer - after.accelerometer_bias, "m/s^2", frame="B", doc="at the IMU, bias removed"
    )
    return with_robot_gains(b.build(), robot)


ESTIMATORS = {"state_estimator": state_estimator}
