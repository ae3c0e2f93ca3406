"""Control of the arms: where each tool should be and how hard it should push, to servo angles at 50 Hz (Fig. 15, 17).

At each tick of the servos, for each arm: the tool's reference moves towards its goal (23) or as the operator's joystick
says (24); a wanted force shifts it (25)-(28), (31); inverse kinematics (7) and the load of gravity give servo angles,
which the position control of the joints with encoders mends (20)-(22).
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import InputError
from aerotact.laws.suarez2020.arm_feedback import ArmFeedback, ArmFrame, Heard, InstrumentedArm, instrumented_arms
from aerotact.laws.suarez2020.bimanual import blended, disconnected, lateral_forces
from aerotact.laws.suarez2020.cartesian_motion import holding_angles, operated, towards, within_reach
from aerotact.laws.suarez2020.compliant_joint import (
    LoopGains,
    add_loop_gains,
    correction,
    next_integral,
    position_error,
)
from aerotact.laws.suarez2020.contact_force import (
    ForceGains,
    add_force_gains,
    force_along,
    force_corrections,
    pushing_angles,
)
from aerotact.ports import BlockBuilder

SERVO_RATE = 50.0
"""Hz at which servos take commands ('Compliant joint control')."""
LEAST_FORCE = 1e-3
"""N, below which no force is wanted."""


@dataclass(frozen=True)
class ArmGains:
    """Parameters that all arms share: of joints, of force, and speeds, m/s, gamma of (31), and how
    fast a load is taken up, kg/s."""

    joint: LoopGains
    force: ForceGains
    speed: Any
    speed_max: Any
    gamma: Any
    load_rate: Any


@dataclass(frozen=True)
class ArmGoal:
    """What is wanted of one arm.

    Attributes:
        r: goal of the tool in frame i, m, whichever way it was given.
        joystick: normalised velocity in frame i, (3,).
        operated: 1 while the joystick counts and the goal does not.
        roll: imposed shoulder roll phi of (7), rad.
        force: on the environment in frame i, N, (3,).
        told: the part of it that is asked for by its deflection and not by an error, N, (3,): what the other arm gives
            too, and all of it where no encoder measures.
        load: mass carried, kg.
    """

    r: Any
    joystick: Any
    operated: Any
    roll: Any
    force: Any
    told: Any
    load: Any


@dataclass(frozen=True)
class ArmsOutput:
    """What the control of the arms gives.

    Attributes:
        servo_cmd: rad, (s,).
        arms: whose they are.
        feedback: of each arm.
        frames: of each arm.
        goals: of each arm.
    """

    servo_cmd: Any
    arms: tuple[InstrumentedArm, ...]
    feedback: tuple[ArmFeedback, ...]
    frames: tuple[ArmFrame, ...]
    goals: tuple[ArmGoal, ...]


def add_arms(b: BlockBuilder, model: Multibody, rate: float, heard: Heard) -> ArmsOutput:
    """Add the control of all arms to a block: references, states and parameters.

    Raises:
        InputError: a rate that is no multiple of 50 Hz.
        RobotError: an arm whose kinematics are not those of the paper.
    """
    every = rate / SERVO_RATE
    if every < 1 or abs(every - round(every)) > 1e-9:
        raise InputError(f"rate is {rate:g} Hz; valid: a multiple of {SERVO_RATE:g} Hz, at which servos take commands")
    gains = _add_gains(b)
    ticks = b.state("tick", 1, "1", doc="steps since the servos' last command")
    b.update("tick", ca.fmod(ticks + 1, round(every)))

    arms = instrumented_arms(model)
    frames = tuple(arm.frame(heard, model.robot.gravity) for arm in arms)
    tools = [_tool_state(b, model, arm) for arm in arms]
    lateral = _lateral(b, arms, tools)
    goals = tuple(_add_goal(b, model, rate, gains, *parts) for parts in zip(arms, frames, lateral, strict=True))
    now = ticks < 0.5
    forces = [_told(b, model, rate, gains, now, arm, goal) for arm, goal in zip(arms, goals, strict=True)]
    told = [known for known, _ in forces]
    feedback = tuple(
        arm.feedback(heard, frame, goal.load, acting, goal.force - goal.told)
        for arm, frame, goal, (_, acting) in zip(arms, frames, goals, forces, strict=True)
    )
    wanted = ca.SX.zeros(model.servos)
    for arm, *parts in zip(arms, tools, frames, goals, told, feedback, strict=True):
        wanted[list(arm.servos)] = _servo_angles(b, gains, now, arm, *parts)
    held = b.state("servo_held", model.servos, "rad", doc="last servo command", default=tuple(model.hover_servo))
    servo_cmd = ca.if_else(now, wanted, held)
    b.update("servo_held", servo_cmd)
    return ArmsOutput(servo_cmd, arms, feedback, frames, goals)


def add_arm_outputs(b: BlockBuilder, out: ArmsOutput) -> None:
    """Outputs of each arm after the command: tool and force as estimated, in W, and whether it came off (33)."""
    threshold = b.parameter("threshold", 1, "m", 0.005, doc="Delta_th of (33)", lower=1e-4)
    grasped = b.reference("grasped", 1, "1", kind="flag", doc="1 while (33) watches; a rise takes the grasping points")
    before = b.state("grasped", 1, "1", kind="flag", doc="grasped, a step ago")
    b.update("grasped", grasped)
    for arm, feedback, frame in zip(out.arms, out.feedback, out.frames, strict=True):
        p_W = frame.p_WS + ca.mtimes(frame.R_WS, feedback.r)
        b.output(f"p_{arm.name}_W", p_W, "m", frame="W", doc=f"tool of arm '{arm.name}' as estimated")
        f_W = ca.mtimes(frame.R_WS, feedback.force)
        b.output(f"f_{arm.name}_W", f_W, "N", frame="W", doc=f"force of arm '{arm.name}' on the environment")
        if not arm.joints:
            continue  # nothing tells it that its links have moved
        kept = b.state(f"r_grasp_{arm.name}", 3, "m", doc=f"grasping point of arm '{arm.name}' in frame i")
        r_grasp = ca.if_else(before < 0.5, feedback.r, kept)
        b.update(f"r_grasp_{arm.name}", r_grasp)
        off = b.state(f"off_{arm.name}", 1, "1", kind="flag", doc=f"arm '{arm.name}' came off")
        now_off = grasped * ca.fmax(off, disconnected(r_grasp, feedback.r, threshold))
        b.update(f"off_{arm.name}", now_off)
        b.output(f"disconnected_{arm.name}", now_off, "1", kind="flag", doc=f"1 since arm '{arm.name}' came off, (33)")


def _add_gains(b: BlockBuilder) -> ArmGains:
    return ArmGains(
        joint=add_loop_gains(b, "position", "1", 0.2, 1.0, 0.2),
        force=add_force_gains(b),
        speed=b.parameter("speed", 1, "m/s", 0.15, doc="v of (23), of the tools towards their goals", lower=0.0),
        speed_max=b.parameter("speed_max", 1, "m/s", 0.1, doc="v_max of (24), at full joystick", lower=0.0),
        load_rate=b.parameter("load_rate", 1, "kg/s", 0.05, doc="at which a load is taken up", lower=0.0),
        gamma=b.parameter("gamma", 1, "1", 1.0, doc="share of the force's corrections, (31)", lower=0.0, limit=1.0),
    )


def _tool_state(b: BlockBuilder, model: Multibody, arm: InstrumentedArm) -> Any:
    """State of the tool's reference in frame i; starts where the tool hovers."""
    start = arm.kinematics.forward(ca.DM(_hover_angles(model, arm))).full().ravel()
    return b.state(f"r_{arm.name}", 3, "m", doc=f"reference of arm '{arm.name}' in frame i", default=tuple(start))


def _hover_angles(model: Multibody, arm: InstrumentedArm) -> Any:
    return model.hover_joint[[model.passive + place for place in arm.servos]]


def _lateral(b: BlockBuilder, arms: tuple[InstrumentedArm, ...], tools: list[Any]) -> list[Any]:
    """Force references of (32) for each arm in frame i, N; zero with other than two arms."""
    if len(arms) != 2:
        return [ca.SX.zeros(3) for _ in arms]
    force = b.reference("f_grasp", 1, "N", doc="force that both arms press together, (32); negative pulls apart")
    offset = ca.DM(arms[1].kinematics.p_JS - arms[0].kinematics.p_JS)
    return list(lateral_forces(force, tools[0], tools[1] + offset))


def _add_goal(
    b: BlockBuilder,
    model: Multibody,
    rate: float,
    gains: ArmGains,
    arm: InstrumentedArm,
    frame: ArmFrame,
    lateral: Any,
) -> ArmGoal:
    """References of one arm. A goal in W follows the base's measured motion, one in frame i moves with the base."""
    name, q = arm.name, _hover_angles(model, arm)
    start = tuple(arm.kinematics.forward(ca.DM(q)).full().ravel())
    r_d = b.reference(f"r_{name}_d", 3, "m", doc=f"goal of arm '{name}' in frame i", default=start)
    p_d = b.reference(f"p_{name}_d", 3, "m", frame="W", doc=f"goal of arm '{name}' in W")
    in_W = b.reference(f"in_W_{name}", 1, "1", kind="flag", doc="1 if the goal in W counts, 0 if that in frame i")
    joystick = b.reference(f"joystick_{name}", 3, "1", doc="operator's velocity in frame i, in +-1, (24)")
    operated_ = b.reference(f"operated_{name}", 1, "1", kind="flag", doc="1 while the joystick counts, not the goal")
    roll = b.reference(f"roll_{name}", 1, "rad", doc="imposed shoulder roll, (7)", default=(float(q[1]),))
    force_W = b.reference(f"f_{name}_d", 3, "N", frame="W", doc="force on the environment; 0 wants none")
    load = b.reference(f"load_{name}", 1, "kg", doc="mass carried at the tool", lower=0.0, limit=10.0)
    force = ca.mtimes(frame.R_WS.T, force_W)
    carried = b.state(f"load_{name}", 1, "kg", doc=f"mass that arm '{name}' is told to carry, taken up slowly")
    taken = gains.load_rate / rate
    carried_next = carried + ca.fmin(ca.fmax(load - carried, -taken), taken)
    b.update(f"load_{name}", carried_next)
    return ArmGoal(
        r=ca.if_else(in_W, frame.point(p_d), r_d),
        joystick=joystick,
        operated=operated_,
        roll=roll,
        force=force + lateral,
        told=lateral if arm.joints else force + lateral,
        load=carried_next,
    )


def _told(
    b: BlockBuilder, model: Multibody, rate: float, gains: ArmGains, now: Any, arm: InstrumentedArm, goal: ArmGoal
) -> tuple[Any, Any]:
    """The told part of the force, N, (3,), on its way: as commanded, and as the servos' lag (17) lets it act."""
    known = b.state(f"told_{arm.name}", 3, "N", doc=f"force of arm '{arm.name}' that needs no measurement")
    acting = b.state(f"acting_{arm.name}", 3, "N", doc="the same behind the servos' lag")
    told = towards(known, goal.told, gains.force.force_rate, 1.0 / SERVO_RATE)
    lag = float(model.servo_time_constants[list(arm.servos)].mean())
    b.update(f"told_{arm.name}", ca.if_else(now, told, known))
    b.update(f"acting_{arm.name}", acting - np.expm1(-1 / (rate * lag)) * (known - acting))
    return known, acting


def _servo_angles(
    b: BlockBuilder,
    gains: ArmGains,
    now: Any,
    arm: InstrumentedArm,
    r: Any,
    frame: ArmFrame,
    goal: ArmGoal,
    told: Any,
    feedback: ArmFeedback,
) -> Any:
    """Servo angles of one arm, rad, (4,); its states move on where `now`."""
    kin, period, name = arm.kinematics, 1.0 / SERVO_RATE, arm.name
    ruled = goal.force - goal.told
    pushing, size = ca.sumsqr(goal.force) > LEAST_FORCE**2, ca.sqrt(ca.sumsqr(ruled) + 1e-12)
    step = ca.if_else(
        goal.operated,
        operated(r, goal.joystick, gains.speed_max, period),
        towards(r, goal.r, gains.speed, period),
    )
    moved = within_reach(kin, blended(r, ca.if_else(pushing, gains.gamma, 0), 0, step - r))
    b.update(f"r_{name}", ca.if_else(now, moved, r))
    if not arm.joints:
        q_ref = kin.inverse(moved, goal.roll)
        return holding_angles(kin, q_ref, frame.up, goal.load) + pushing_angles(kin, q_ref, told)

    shift = b.state(f"shift_{name}", 3, "m", doc=f"integral of the force error of arm '{name}'")
    n = ruled / size
    error = n * (size - force_along(kin, feedback.q, feedback.force, n, arm.joints))
    more, at_once = force_corrections(gains.force, kin, feedback.q, error, period)
    after = ca.if_else(pushing, blended(shift, gains.gamma, more, 0), towards(shift, 0 * shift, gains.speed, period))
    held = within_reach(kin, moved + after)
    b.update(f"shift_{name}", ca.if_else(now, held - moved, shift))
    r_stiff = within_reach(kin, blended(held, gains.gamma, ca.if_else(pushing, at_once, 0), 0))

    q_ref, chosen = kin.inverse(r_stiff, goal.roll), list(arm.joints)
    theta = holding_angles(kin, q_ref, frame.up, goal.load) + pushing_angles(kin, q_ref, told)
    link = position_error(q_ref[chosen], feedback.theta[chosen], (feedback.theta - feedback.q)[chosen])
    integral = b.state(f"integral_{name}", len(chosen), "rad s", doc=f"of the links' error of arm '{name}', (21)")
    summed = next_integral(gains.joint, integral, link, 1, period)
    b.update(f"integral_{name}", ca.if_else(ca.logic_and(now, ca.logic_not(pushing)), summed, integral))
    theta[chosen] += correction(gains.joint, ca.if_else(pushing, 0, link), integral)
    return theta
