"""suarez2020_joint_control: torque or position of the joints with encoders, on the bench; (14), (18)-(22), Fig. 16."""

import casadi as ca
import numpy as np

from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.arm_feedback import listen
from aerotact.laws.suarez2020.compliant_joint import (
    add_loop_gains,
    correction,
    next_integral,
    position_error,
    servo_reference,
    spring_torque,
)
from aerotact.ports import Block, BlockBuilder

RESOLUTION = 0.005
"""rad, what the integrals may ask: enough to pass the servo's resolution, at which (22) without them stands still."""


def suarez2020_joint_control(model: Model, rate: float) -> Block:
    """Torque or position control of the joints with encoders at `rate` Hz; the other servos stand where told.

    For arms on a bench: the rotors get their least thrust.

    Raises:
        MissingCapability: no arms, or none of their joints has an encoder.
    """
    law = "suarez2020_joint_control"
    model.require(["arm"], f"law {law}")
    entry = model.robot.file.sensors.deflection
    if not isinstance(model, Multibody) or entry is None:
        raise MissingCapability(f"law {law} needs sensors.deflection, which robot '{model.robot.name}' lacks")
    b = BlockBuilder(law, "suarez2020", rate, "torque or position of compliant joints")
    heard = listen(b, model, ca.SX.zeros(3), ca.SX([1, 0, 0, 0]))
    names = [joint.name for joint in model.compliant]
    chosen = [names.index(name) for name in entry.joints]
    n = len(chosen)
    hover = tuple(model.hover_joint[[model.passive + i for i in chosen]])
    servo_d = b.reference(
        "servo_d", model.servos, "rad", doc="angles of the other servos", default=tuple(model.hover_servo)
    )
    q_ref = b.reference("joint_d", n, "rad", doc="links of the joints with encoders", default=hover)
    tau_ref = b.reference("torque_d", n, "N m", doc="torques of the joints with encoders")
    by_position = b.reference(
        "by_position", n, "1", doc="delta of (22): 1 by position, 0 by torque", default=(1.0,) * n
    )
    gains = {
        "torque": add_loop_gains(b, "torque", "rad/(N m)", 0.3, 2.0, RESOLUTION),
        "position": add_loop_gains(b, "position", "1", 0.2, 0.5, RESOLUTION),
    }

    theta, angle = heard.servo[chosen], heard.deflection
    stiffness, damping = ca.DM(model.stiffness[chosen]), ca.DM(model.damping[chosen])
    held = tuple(model.hover_servo[chosen] - np.array(hover))
    before = b.state("deflection_before", n, "rad", doc="deflection, a step ago", default=held)
    b.update("deflection_before", angle)
    torque = spring_torque(stiffness, damping, angle, rate * (angle - before))
    errors = {"torque": tau_ref - torque, "position": position_error(q_ref, theta, angle)}
    on = {"torque": by_position < 0.5, "position": by_position > 0.5}
    corrections = {}
    for name, unit in (("torque", "N m s"), ("position", "rad s")):
        integral = b.state(f"{name}_integral", n, unit, doc=f"integral of the {name} error")
        b.update(f"{name}_integral", next_integral(gains[name], integral, errors[name], on[name], 1 / rate))
        corrections[name] = correction(gains[name], errors[name], integral)
    wanted = ca.SX(servo_d)
    wanted[chosen] = servo_reference(theta, corrections["position"], corrections["torque"], by_position)
    least, _ = model.thrust_limits
    b.output("thrust_cmd", ca.DM(least), "N", doc="the least", default=tuple(model.robot.hover_thrust))
    b.output("servo_cmd", wanted, "rad", doc="servo commands", default=tuple(model.hover_servo))
    b.output("torque_est", torque, "N m", doc="torques of the joints with encoders, (15)")
    b.output("joint_est", theta - angle, "rad", doc="links of the joints with encoders, (14)")
    b.limit_with(actuator_limiter(model, rate))
    return with_robot_gains(b.build(), model.robot)


LAWS = {"suarez2020_joint_control": suarez2020_joint_control}
