"""Tasks of two arms, (29)-(33): a bar's pose, a lateral grasp, un-plugging, and an arm that tells where the base is.

Positions are m, forces N. Arm 1 is the left one, arm 2 the right one.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics.arm_kinematics import ArmKinematics


def bar_pose(r_1: Any, r_2: Any) -> tuple[Any, Any]:
    """Centre, (29), and direction from arm 2 to arm 1, (30), of a bar between the tools, in the frame of r_1, r_2."""
    return (r_1 + r_2) / 2, direction(r_1, r_2)


def bar_goals(centre: Any, axis: Any, grip: Any) -> tuple[Any, Any]:
    """Tools that give a bar its pose: the inverse of (29), (30) for a distance `grip` between them."""
    return centre + grip / 2 * axis, centre - grip / 2 * axis


def direction(r_1: Any, r_2: Any) -> Any:
    """Unit vector from r_2 to r_1; shorter where they meet, and never without an answer."""
    between = r_1 - r_2
    return between / ca.sqrt(ca.sumsqr(between) + 1e-12)


def lateral_forces(force: Any, r_1: Any, r_2: Any) -> tuple[Any, Any]:
    """Force references of both arms, (32): they press what is between them with `force`, and pull it if negative."""
    axis = direction(r_1, r_2)
    return -force * axis, force * axis


def blended(r: Any, gamma: Any, by_force: Any, by_position: Any) -> Any:
    """Reference of a tool, m, (3,), (31): where it was, gamma of the force's step, the rest of the position's."""
    return r + gamma * by_force + (1 - gamma) * by_position


def disconnected(r_grasp: Any, r_tool: Any, threshold: Any) -> Any:
    """1 if a tool has left its grasping point by more than the threshold, (33)."""
    return ca.sumsqr(r_grasp - r_tool) > threshold**2


def base_from_tool(kinematics: ArmKinematics, q_WB: Any, swing: Any, q: Any, p_W: Any) -> Any:
    """Base's position in W, m, (3,), from joint angles q of an arm whose tool holds a point of W: arm as a sensor.

    Args:
        kinematics: of the arm.
        q_WB: attitude of the base.
        swing: angle of the passive joint, rad; any number without one.
        q: joint angles, (4,).
        p_W: the point, (3,).
    """
    return p_W - kinematics.from_shoulder(ca.DM.zeros(3), q_WB, swing, kinematics.forward(q))
