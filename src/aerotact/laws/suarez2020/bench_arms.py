"""suarez2020_arms: both arms on a bench: tool positions, forces, bimanual tasks; the rotors get their least thrust."""

import casadi as ca

from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.arm_control import add_arm_outputs, add_arms
from aerotact.laws.suarez2020.arm_feedback import listen
from aerotact.ports import Block, BlockBuilder


def suarez2020_arms(model: Model, rate: float) -> Block:
    """Control of the arms alone at `rate` Hz, a multiple of the servos' 50 Hz.

    Raises:
        MissingCapability: no arms.
        InputError: a rate that does not fit.
    """
    law = "suarez2020_arms"
    model.require(["arm"], f"law {law}")
    if not isinstance(model, Multibody):
        raise MissingCapability(f"law {law} needs arms, which robot '{model.robot.name}' lacks")
    b = BlockBuilder(law, "suarez2020", rate, "tools and forces of compliant arms on a bench")
    p_WB = b.measurement("p_WB", 3, "m", frame="W", doc="position of the base")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion")
    arms = add_arms(b, model, rate, listen(b, model, p_WB, q_WB))
    least, _ = model.thrust_limits
    b.output("thrust_cmd", ca.DM(least), "N", doc="the least", default=tuple(model.robot.hover_thrust))
    b.output("servo_cmd", arms.servo_cmd, "rad", doc="servo commands", default=tuple(model.hover_servo))
    add_arm_outputs(b, arms)
    b.limit_with(actuator_limiter(model, rate))
    return with_robot_gains(b.build(), model.robot)


LAWS = {"suarez2020_arms": suarez2020_arms}
