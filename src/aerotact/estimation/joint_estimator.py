"""joint_estimator: angles and rates of passive and compliant joints from servo feedback and encoders.

A link's angle is what an encoder says: a passive joint's own, or the servo's angle less the measured deflection,
suarez2020 (14), (20). Joints without a deflection encoder are taken to sag under the links' weight alone,
q = theta - gravity_torque / k. A critically damped second-order filter follows each angle and gives its rate.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import hover_poses
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability, RobotError
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder


def track(angle: Any, rate: Any, measured: Any, bandwidth: Any, period: float) -> tuple[Any, Any]:
    """Angle and rate one step later: the filter whose two poles are exp(-bandwidth period), exact on a steady rate.

    Args:
        angle, rate: now, rad and rad/s, (n,).
        measured: one period later, rad, (n,).
        bandwidth: rad/s, (n,).
        period: s.
    """
    pole = ca.exp(-bandwidth * period)
    ahead = angle + period * rate
    error = measured - ahead
    return ahead + (1 - pole**2) * error, rate + (1 - pole) ** 2 / period * error


def require_joints(model: Model, who: str) -> Multibody:
    """The model, which must have arms or passive joints, with an encoder or a servo's feedback on each.

    Raises:
        MissingCapability: it is a rigid body.
        RobotError: a joint that nothing measures.
    """
    if not isinstance(model, Multibody):
        raise MissingCapability(
            f"{who} needs arm or passive_joint, which robot '{model.robot.name}' ({model.robot.folder}) lacks; "
            f"it has: {', '.join(sorted(model.capabilities))}"
        )
    robot, sensors = model.robot, model.robot.file.sensors
    heard = sensors.passive.joints if sensors.passive else []
    deaf = [joint.name for joint in robot.passive if joint.name not in heard]
    if deaf:
        raise RobotError(
            robot.folder / "robot.toml", "sensors.passive", f"no encoder on '{deaf[0]}'", f"{who} needs one: list it"
        )
    if robot.arms and sensors.servo is None:
        raise RobotError(robot.folder / "robot.toml", "sensors.servo", "is missing", f"{who} needs it: give its rate")
    return model


def joint_estimator(model: Model, rate: float) -> Block:
    """Angles and rates of all joints, in the order of the model's `joint`.

    Raises:
        MissingCapability: the robot has no joints.
        RobotError: a joint that nothing measures.
    """
    arms = require_joints(model, "estimator joint_estimator")
    robot, sensors, n = arms.robot, arms.robot.file.sensors, arms.passive
    b = BlockBuilder("joint_estimator", "suarez2020", rate, "angles and rates of passive and compliant joints")
    hover = tuple(arms.hover_joint)
    angle = b.state("joint", arms.joints, "rad", doc="joint angles", default=hover)
    speed = b.state("joint_rate", arms.joints, "rad/s", doc="rates of the joint angles")
    started = b.state("started", 1, "1", kind="flag", doc="1 after the first step") > 0
    q_WB = b.measurement(
        "q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion", default=hover_poses(arms)["q_WB"]
    )
    links: list[Any] = []
    bandwidths: list[Any] = []
    if n:
        names = list(sensors.passive.joints) if sensors.passive else []
        passive = b.measurement(
            "passive_measured", len(names), "rad", doc="encoders of passive joints", default=_hover(arms, names)
        )
        swing = b.parameter("swing_bandwidth", 1, "rad/s", 60.0, doc="of passive joints", lower=0.0)
        links += [passive[names.index(joint.name)] for joint in robot.passive]
        bandwidths += [swing] * n
    if arms.servos:
        servo = b.measurement(
            "servo_measured", arms.servos, "rad", doc="servos' feedback", default=tuple(arms.hover_servo)
        )
        entry = sensors.deflection
        names = list(entry.joints) if entry else []
        sag = arms.gravity_torque(arms.state_at(q_WB, angle))[n:] / ca.DM(arms.stiffness)
        if names:
            rest = arms.hover_servo - arms.hover_joint[n:]
            places = [[joint.name for joint in arms.compliant].index(name) for name in names]
            deflection = b.measurement(
                "deflection_measured", len(names), "rad", doc="encoders of deflections", default=tuple(rest[places])
            )
            for number, place in enumerate(places):
                sag[place] = deflection[number]
        joint_bandwidth = b.parameter("joint_bandwidth", 1, "rad/s", 30.0, doc="of the arms' joints", lower=0.0)
        links += ca.vertsplit(servo - sag)
        bandwidths += [joint_bandwidth] * arms.servos

    measured = ca.vertcat(*links)
    followed = track(angle, speed, measured, ca.vertcat(*bandwidths), 1.0 / rate)
    angle_next = ca.if_else(started, followed[0], measured)
    speed_next = ca.if_else(started, followed[1], 0)
    b.update("joint", angle_next)
    b.update("joint_rate", speed_next)
    b.update("started", 1)
    b.output("joint", angle_next, "rad", doc="joint angles", default=hover)
    b.output("joint_rate", speed_next, "rad/s", doc="rates of the joint angles")
    return with_robot_gains(b.build(), robot)


def _hover(model: Multibody, names: list[str]) -> tuple[float, ...]:
    """Angles of joints in the hover keyframe."""
    return tuple(float(model.hover_joint[model.bodies.joints.index(name)]) for name in names)


ESTIMATORS = {"joint_estimator": joint_estimator}
