"""force_sensor: the tool's wrench from a six-axis force/torque sensor: weight and tare taken off, filtered.

bodie2021, 'Force Sensor Filtering': a second-order Butterworth filter of 5 Hz; inertial forces of what the sensor
carries are neglected, as there. Sign: by the robot on the environment.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import hover_poses, numbers
from aerotact.estimation.butterworth import at_rest, butterworth, low_pass
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder
from aerotact.robot import ForceTorque

HIGHEST_CUTOFF = 0.45  # of the rate


def sensor_of(model: Model) -> ForceTorque:
    """The robot's force/torque sensor.

    Raises:
        MissingCapability: it has none.
    """
    if model.robot.force_torque is None:
        raise MissingCapability(f"force_sensor needs force_torque, which robot '{model.robot.name}' lacks")
    return model.robot.force_torque


def without_weight(model: Model, f_S: Any, tau_S: Any, q_WB: Any) -> tuple[Any, Any]:
    """Force, N, and torque about the sensor's origin, N m, in S, without the weight of what the sensor carries.

    The sensor holds that weight up: it reads m_d g upwards at the centre of mass D of what it carries.
    """
    sensor = sensor_of(model)
    R_WS = ca.mtimes(so3.rotation(q_WB), ca.DM(sensor.R_BS))
    lift_S = ca.mtimes(R_WS.T, ca.DM([0, 0, sensor.distal_mass * model.robot.gravity]))
    return f_S - lift_S, tau_S - ca.cross(ca.DM(sensor.p_SD), lift_S)


def wrench_at_tip(model: Model, f_S: Any, tau_S: Any) -> tuple[Any, Any]:
    """Force, N, and torque about the tool's tip, N m, both in B, from those about the sensor's origin in S."""
    sensor = sensor_of(model)
    R_BS = ca.DM(sensor.R_BS)
    f_B = ca.mtimes(R_BS, f_S)
    return f_B, ca.mtimes(R_BS, tau_S) - ca.cross(ca.DM(model.robot.p_BE - sensor.p_BS), f_B)


def add_force_sensor(b: BlockBuilder, model: Model, rate: float, q_WB: Any) -> tuple[Any, Any]:
    """Ports, states and equations: the filtered wrench of the robot on the environment at the tool's tip.

    While the reference `calibrate` is 1 (contact-free hover) the sensor's mean reading, the tare, is learnt; at 0 it is
    held. Each rise of `calibrate` starts a new mean. The filter starts at rest at the first sample.

    Args:
        b: takes the measurements f_sensor_S and tau_sensor_S, the flag `calibrate` and the parameter force_cutoff.
        model: gives the sensor.
        rate: Hz.
        q_WB: attitude of the base.

    Returns:
        f_push_B, N, and tau_push_B about the tip, N m: by the robot on the environment, in B.
    """
    level, nothing = ca.DM(hover_poses(model)["q_WB"]), ca.DM.zeros(3)
    hover = [numbers(-part.full()) for part in without_weight(model, nothing, nothing, level)]
    f_S = b.measurement(
        "f_sensor_S", 3, "N", frame="S", doc="sensor's force, by the robot, with the tool's weight", default=hover[0]
    )
    tau_S = b.measurement(
        "tau_sensor_S", 3, "N m", frame="S", doc="sensor's torque, by the robot, about its origin", default=hover[1]
    )
    calibrate = b.reference("calibrate", 1, "1", kind="flag", doc="1 in contact-free hover: learn the tare")
    cutoff = b.parameter(
        "force_cutoff", 1, "Hz", 5.0, doc="cut-off of the force filter", lower=0.01, limit=HIGHEST_CUTOFF * rate
    )
    tare = b.state("tare_S", 6, "N", frame="S", doc="learnt reading without contact, force N and torque N m")
    samples = b.state("tare_samples", 1, "1", doc="samples in the tare's mean")
    sensed = b.state("sensed", 1, "1", kind="flag", doc="1 after the sensor's first sample")
    z1 = b.state("force_filter_1", 6, "N", frame="S", doc="memory of the filter")
    z2 = b.state("force_filter_2", 6, "N", frame="S", doc="memory of the filter")

    reading = ca.vertcat(*without_weight(model, f_S, tau_S, q_WB))
    learning = calibrate > 0
    count = samples * learning + 1
    tare_next = tare + learning / count * (reading - tare)
    wrench = reading - tare_next

    num, den = butterworth(cutoff, rate)
    rest_1, rest_2 = at_rest(num, den, wrench)
    running = sensed > 0
    filtered, z1_next, z2_next = low_pass(
        num, den, ca.if_else(running, z1, rest_1), ca.if_else(running, z2, rest_2), wrench
    )
    b.update("tare_S", tare_next)
    b.update("tare_samples", count * learning)
    b.update("sensed", 1)
    b.update("force_filter_1", z1_next)
    b.update("force_filter_2", z2_next)
    return wrench_at_tip(model, filtered[0:3], filtered[3:6])


def force_sensor(model: Model, rate: float) -> Block:
    """The tool's wrench from the force/torque sensor, at `rate` Hz.

    Raises:
        MissingCapability: the robot has no force/torque sensor.
    """
    model.require(["force_torque"], "estimator force_sensor")
    b = BlockBuilder("force_sensor", "bodie2021", rate, "wrench on the environment: weight and tare off, Butterworth")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion", doc="attitude of the base")
    f_B, tau_B = add_force_sensor(b, model, rate, q_WB)
    b.output("f_push_B", f_B, "N", frame="B", doc="force of the robot on the environment")
    b.output("tau_push_B", tau_B, "N m", frame="B", doc="torque of the robot on the environment about the tool's tip")
    return with_robot_gains(b.build(), model.robot)


ESTIMATORS = {"force_sensor": force_sensor}
