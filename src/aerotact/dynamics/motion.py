"""Motion: of base, tool and centre of mass of one rigid robot, from one another, and their ports.

The base's origin B, the tool's tip E and the centre of mass C are three points of the same body.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.admittance import ToolMotion
from aerotact.dynamics.model import Model
from aerotact.ports import BlockBuilder


@dataclass(frozen=True)
class BaseMotion:
    """Motion of the base's origin: p_WB m, q_WB, v_WB m/s in W, w_B rad/s in B, a_WB m/s2 in W, dw_B rad/s2 in B."""

    p_WB: Any
    q_WB: Any
    v_WB: Any
    w_B: Any
    a_WB: Any = None
    dw_B: Any = None


def com_motion(model: Model, base: BaseMotion) -> tuple[Any, Any, Any]:
    """Position m, velocity m/s and acceleration m/s2 of the centre of mass, in W; the last needs base.a_WB and dw_B."""
    p_BC, R_WB, w = ca.sparsify(ca.DM(model.robot.p_BC)), so3.rotation(base.q_WB), base.w_B
    p_WC = base.p_WB + ca.mtimes(R_WB, p_BC)
    v_WC = base.v_WB + ca.mtimes(R_WB, ca.cross(w, p_BC))
    if base.a_WB is None:
        return p_WC, v_WC, None
    return p_WC, v_WC, base.a_WB + ca.mtimes(R_WB, ca.cross(base.dw_B, p_BC) + ca.cross(w, ca.cross(w, p_BC)))


def base_reference(model: Model, tool: ToolMotion) -> BaseMotion:
    """Base from tool: ryll2019 (29), (30) and the accelerations below them, with the errata; bodie2021 (40).

    Lever arms turn with the reference attitude, and angular velocities change frame between tool and base.
    """
    robot = model.robot
    q_WB = so3.product(tool.q_WE, so3.conjugate(ca.DM(model.q_BE)))
    R_WB = so3.rotation(q_WB)
    p_BE_W = ca.mtimes(R_WB, ca.DM(robot.p_BE))
    w, dw = tool.w_WE, tool.dw_WE
    return BaseMotion(
        p_WB=tool.p_WE - p_BE_W,
        q_WB=q_WB,
        v_WB=tool.v_WE - ca.cross(w, p_BE_W),
        w_B=ca.mtimes(R_WB.T, w),
        a_WB=tool.a_WE - ca.cross(dw, p_BE_W) - ca.cross(w, ca.cross(w, p_BE_W)),
        dw_B=ca.mtimes(R_WB.T, dw),
    )


def numbers(vector: Any) -> tuple[float, ...]:
    """A numpy or constant CasADi vector as the default of a port."""
    return tuple(float(v) for v in np.ravel(vector))


def hover_poses(model: Model) -> dict[str, tuple[float, ...]]:
    """Default poses: of base and tool in the hover keyframe."""
    p_WE, q_WE = (ca.DM(v).full() for v in model.tool_pose(ca.DM(model.hover_state)))
    poses = {**model.state.unpack(model.hover_state), "p_WE": p_WE, "q_WE": q_WE}
    return {name: numbers(pose) for name, pose in poses.items()}


def add_base(b: BlockBuilder, model: Model) -> BaseMotion:
    """Measured motion of the base."""
    at = hover_poses(model)
    return BaseMotion(
        p_WB=b.measurement("p_WB", 3, "m", frame="W", doc="position of the base", default=at["p_WB"]),
        q_WB=b.measurement(
            "q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion", default=at["q_WB"]
        ),
        v_WB=b.measurement("v_WB", 3, "m/s", frame="W", doc="velocity of the base"),
        w_B=b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base"),
    )


def add_desired_tool(b: BlockBuilder, model: Model) -> ToolMotion:
    """Desired motion of the tool, its angular quantities turned from the desired tool's axes to W."""
    at = hover_poses(model)
    p_d = b.reference("p_WE_d", 3, "m", frame="W", doc="desired position of the tool", default=at["p_WE"])
    q_d = b.reference(
        "q_WE_d", 4, "1", frame="W", doc="desired attitude of the tool", kind="quaternion", default=at["q_WE"]
    )
    v_d = b.reference("v_WE_d", 3, "m/s", frame="W", doc="desired velocity of the tool")
    w_E_d = b.reference("w_E_d", 3, "rad/s", frame="E", doc="desired angular velocity of the tool")
    a_d = b.reference("a_WE_d", 3, "m/s^2", frame="W", doc="desired acceleration of the tool")
    dw_E_d = b.reference("dw_E_d", 3, "rad/s^2", frame="E", doc="desired angular acceleration of the tool")
    R_WE_d = so3.rotation(q_d)
    return ToolMotion(p_d, q_d, v_d, ca.mtimes(R_WE_d, w_E_d), a_d, ca.mtimes(R_WE_d, dw_E_d))
