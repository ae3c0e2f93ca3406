"""suarez2020_tools: both arms in flight, to be flown outside of suarez2020_base, which carries them.

Goals in W are followed with the base's estimated motion, so that the arms make up for it. What the arms press with and
carry is handed to the platform, which compensates it ('General control framework', wrench estimator).
"""

from typing import Any

import casadi as ca

from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import hover_poses
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.arm_control import LEAST_FORCE, ArmsOutput, add_arm_outputs, add_arms
from aerotact.laws.suarez2020.arm_feedback import listen
from aerotact.ports import Block, BlockBuilder


def suarez2020_tools(model: Model, rate: float) -> Block:
    """Control of the arms at `rate` Hz, a multiple of the servos' 50 Hz, as an outer controller of suarez2020_base.

    Raises:
        MissingCapability: no arms.
        InputError: a rate that does not fit.
    """
    law = "suarez2020_tools"
    model.require(["arm"], f"law {law}")
    if not isinstance(model, Multibody):
        raise MissingCapability(f"law {law} needs arm, which robot '{model.robot.name}' lacks")
    b = BlockBuilder(law, "suarez2020", rate, "tools and forces of compliant arms in flight")
    at = hover_poses(model)
    p_WB = b.measurement("p_WB", 3, "m", frame="W", doc="position of the base", default=at["p_WB"])
    q_WB = b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion", default=at["q_WB"])
    arms = add_arms(b, model, rate, listen(b, model, p_WB, q_WB))
    b.output("servo_r", arms.servo_cmd, "rad", doc="servo angles", default=tuple(model.hover_servo))
    f_tools_W = _add_borne(b, model, rate, arms)
    b.output("f_tools_W_r", f_tools_W, "N", frame="W", doc="force of the environment on each arm's tool")
    add_arm_outputs(b, arms)
    return with_robot_gains(b.build(), model.robot)


def _add_borne(b: BlockBuilder, model: Multibody, rate: float, arms: ArmsOutput) -> Any:
    """Force of the environment on each tool, N in W: what the arm presses with, and the weight that it carries."""
    lag = b.parameter("pressing_lag", 1, "s", 0.2, doc="low-pass of the force that the platform is told of", lower=1e-3)
    borne = []
    for feedback, frame, goal in zip(arms.feedback, arms.frames, arms.goals, strict=True):
        size = ca.sqrt(ca.sumsqr(goal.force) + 1e-12)
        along = ca.fmin(ca.fmax(ca.dot(goal.force, feedback.acting) / size, 0), 1.5 * size)
        pressed = ca.if_else(size > LEAST_FORCE, along, 0) * goal.force / size
        borne.append(-ca.mtimes(frame.R_WS, pressed) - ca.vertcat(0, 0, goal.load * model.robot.gravity))
    told = b.state("f_tools_W", 3 * len(borne), "N", frame="W", doc="force of the environment on each tool")
    told_next = told + (1 - ca.exp(-1 / (rate * lag))) * (ca.vertcat(*borne) - told)
    b.update("f_tools_W", told_next)
    return told_next


LAWS = {"suarez2020_tools": suarez2020_tools}
