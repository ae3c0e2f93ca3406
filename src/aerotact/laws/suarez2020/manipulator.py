"""suarez2020_manipulator: control of the arms in flight; gives the platform's law the servo angles and the forces."""

from typing import Any

import casadi as ca

from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import hover_poses
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.gains import with_robot_gains
from aerotact.laws.suarez2020.arm_control import ArmsOutput, add_arm_outputs, add_arms
from aerotact.laws.suarez2020.arm_feedback import listen
from aerotact.ports import Block, BlockBuilder


def suarez2020_manipulator(model: Model, rate: float) -> Block:
    """Control of the arms at `rate` Hz, a multiple of the servos' 50 Hz, to be flown outside of suarez2020_base.

    Raises:
        MissingCapability: no arms.
        InputError: a rate that does not fit.
    """
    law = "suarez2020_manipulator"
    model.require(["arm"], f"law {law}")
    if not isinstance(model, Multibody):
        raise MissingCapability(f"law {law} needs arms, which robot '{model.robot.name}' lacks")
    b = BlockBuilder(law, "suarez2020", rate, "tools and forces of compliant arms in flight")
    at = hover_poses(model)
    p_WB = b.measurement("p_WB", 3, "m", frame="W", doc="position of the base", default=at["p_WB"])
    q_WB = b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion", default=at["q_WB"])
    arms = add_arms(b, model, rate, listen(b, model, p_WB, q_WB))
    b.output("servo_r", arms.servo_cmd, "rad", doc="servo angles", default=tuple(model.hover_servo))
    doc = "force of the environment on each arm's tool, for the platform to bear"
    b.output("f_tools_W_r", _borne(b, model, rate, arms), "N", frame="W", doc=doc)
    add_arm_outputs(b, arms)
    return with_robot_gains(b.build(), model.robot)


def _borne(b: BlockBuilder, model: Multibody, rate: float, arms: ArmsOutput) -> Any:
    """Forces that the platform has to bear, N in W, (3 arms,), behind a first-order low-pass: contacts and loads."""
    cutoff = b.parameter("reaction_cutoff", 1, "rad/s", 5.0, doc="low-pass of the forces that are passed on", lower=0.0)
    forces = []
    for feedback, frame, goal in zip(arms.feedback, arms.frames, arms.goals, strict=True):
        weight = ca.vertcat(0, 0, goal.load * model.robot.gravity)
        forces.append(-ca.mtimes(frame.R_WS, feedback.acting) - weight)
    wanted = ca.vertcat(*forces)
    low = b.state("borne", int(wanted.shape[0]), "N", frame="W", doc="forces behind the low-pass")
    after = low + (1 - ca.exp(-cutoff / rate)) * (wanted - low)
    b.update("borne", after)
    return after


LAWS = {"suarez2020_manipulator": suarez2020_manipulator}
