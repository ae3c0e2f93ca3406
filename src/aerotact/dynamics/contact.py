"""Contact: the force of a surface on the tool's tip, as a smooth function of state and actuators.

A surface is locally a plane with unit normal n_W from the surface to the robot; gap = n_W . p_WE - offset. The force on
the tool is F (n_W + friction_W), friction_W being told and not a function of the state: friction that opposes the
predicted sliding, smoothed about zero, would stop the tip at mu F / (m_tip v_smooth), hundreds of 1/s, far beyond what
the steps of a horizon can integrate. The normal force F is a blend of two:

    rigid      F makes the tip's normal velocity decay with SETTLING: no stiffness enters
    compliant  F = stiffness * penetration + damping * speed of approach, smooth and unilateral

The rigid force suits a tip that is held to a hard wall; it may be negative, where the actuators pull the tip away. The
compliant one suits free flight towards a surface, and soft surfaces.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model

SETTLING = 12.0  # 1/s
SMOOTH_GAP = 1e-3  # m, over which the compliant force sets in


@dataclass(frozen=True)
class Surface:
    """A plane near the tool.

    Attributes:
        n_W: unit normal from the surface to the robot, (3,).
        offset: n_W . p of the plane's points, m.
        friction_W: tangential force on the tip for each newton of normal force, (3,).
        stiffness, damping: of the compliant force, N/m and N s/m.
        rigid: 1 for the rigid force, 0 for the compliant one, or between.
    """

    n_W: Any
    offset: Any
    friction_W: Any
    stiffness: Any
    damping: Any
    rigid: Any


def gap(model: Model, x: Any, surface: Surface) -> Any:
    """Distance of the tip to the plane, m, negative behind it."""
    return ca.dot(surface.n_W, model.tool_pose(x)[0]) - surface.offset


def tangential(n_W: Any, vector_W: Any) -> Any:
    """The part of a vector that lies in the plane."""
    return vector_W - ca.dot(n_W, vector_W) * n_W


def tool_wrench(model: Model, q_WB: Any, f_tool_W: Any) -> Any:
    """Force on the tool's tip, N in W, as a wrench p of the model, (6,): force in W, torque about the COM in B."""
    p_CE = ca.DM(model.robot.p_BE - model.robot.p_BC)
    f_B = ca.mtimes(so3.rotation(q_WB).T, f_tool_W)
    return ca.vertcat(f_tool_W, ca.cross(p_CE, f_B))


@dataclass(frozen=True)
class ContactMotion:
    """How the robot moves with the contact: `force` N along the normal, `f_tool_W` N, accelerations as of the model."""

    force: Any
    f_tool_W: Any
    a_WB: Any
    dw_B: Any


def contact_motion(model: Model, x: Any, p: Any, surface: Surface) -> ContactMotion:
    """Force of the surface on the tip, and the accelerations that it leaves.

    Args:
        model: of the robot.
        x: state.
        p: wrench on the robot besides the contact's, (6,).
        surface: the plane.
    """
    robot, s, n = model.robot, model.state.split(x), surface.n_W
    p_BE, p_CE, p_BC = (ca.DM(v) for v in (robot.p_BE, robot.p_BE - robot.p_BC, robot.p_BC))
    R_WB, w = so3.rotation(s["q_WB"]), s["w_B"]
    v_WE, _ = model.tool_twist(x)
    v_n = ca.dot(n, v_WE)
    direction = n + surface.friction_W

    # All accelerations are affine in the force: these are what a newton of it adds.
    dw_unit = ca.mtimes(model.inverse_inertia, ca.cross(p_CE, ca.mtimes(R_WB.T, direction)))
    a_unit = direction / robot.mass - ca.mtimes(R_WB, ca.cross(dw_unit, ca.sparsify(p_BC)))
    a_free, dw_free = model.accelerations(x, p)
    n_B = ca.mtimes(R_WB.T, n)
    free = ca.dot(n, a_free) + ca.dot(n_B, ca.cross(dw_free, p_BE) + ca.cross(w, ca.cross(w, p_BE)))
    slope = ca.dot(n, a_unit) + ca.dot(n_B, ca.cross(dw_unit, p_BE))
    rigid = -(free + SETTLING * v_n) / slope

    depth = -gap(model, x, surface) / SMOOTH_GAP
    penetration = SMOOTH_GAP * (ca.fmax(depth, 0) + ca.log1p(ca.exp(ca.fmin(depth, -depth))))
    touching = 1 / (1 + ca.exp(-ca.fmin(ca.fmax(depth, -30), 30)))
    compliant = surface.stiffness * penetration - surface.damping * touching * v_n

    force = surface.rigid * rigid + (1 - surface.rigid) * compliant
    return ContactMotion(force, force * direction, a_free + force * a_unit, dw_free + force * dw_unit)
