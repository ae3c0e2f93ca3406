"""Motion of an arm's tool in the arm's frame i: towards a goal, (23), or at an operator's velocity, (24).

Positions are m, speeds m/s. Both printed equations step from the measured tool; here the step starts from the step
before (docs/errata.md), so that its speed is the one asked for and the servo's resolution does not stop it.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics.arm_kinematics import ArmKinematics

REACH = 0.985
"""Share of the whole length of an arm to which its goals are held."""
NEAREST = 0.25
"""The same at the other end: the tool stays out of the shoulder."""


def towards(r: Any, r_goal: Any, speed: Any, period: float) -> Any:
    """Where the tool should be one period later on its straight way to a goal: the first two terms of (23).

    The step is v T along the error, and the error itself once it is shorter.
    """
    error = r_goal - r
    length = ca.sqrt(ca.sumsqr(error) + 1e-18)
    return r + error * ca.fmin(1, speed * period / length)


def operated(r: Any, joystick: Any, speed_max: Any, period: float) -> Any:
    """Where the tool should be one period later under an operator's velocity: the first two terms of (24).

    Args:
        r: where it should be now, (3,).
        joystick: normalised velocity in frame i, (3,); each beyond +-1 counts as +-1.
        speed_max: v_max.
        period: T, s.
    """
    return r + speed_max * period * ca.fmin(ca.fmax(joystick, -1), 1)


def within_reach(kinematics: ArmKinematics, r: Any) -> Any:
    """The nearest point on the ray from the shoulder that is neither too far nor too near."""
    whole = kinematics.upper + kinematics.lower
    length = ca.sqrt(ca.sumsqr(r) + 1e-18)
    return r * ca.fmin(ca.fmax(length, NEAREST * whole), REACH * whole) / length


def holding_angles(kinematics: ArmKinematics, q: Any, up: Any, load: Any) -> Any:
    """Servo angles that hold the links at q against gravity and a mass at the tool: the term Delta r_G of (23), (24).

    As an angle of each joint it is exact where a shift of the goal is so to first order.

    Args:
        kinematics: of the arm.
        q: joint angles, (4,).
        up: gravity's reaction in frame i, m/s2, (3,).
        load: mass carried at the tool, kg.
    """
    carried = load * ca.mtimes(kinematics.jacobian(q).T, up)
    return kinematics.servo_for(q, kinematics.gravity_torque(q, up) + carried)
