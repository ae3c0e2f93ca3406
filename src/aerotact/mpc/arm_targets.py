"""Arm targets: from measurement and reference to the stage parameters of an OCP with a reduced predictor.

Three modes follow from the force wanted and the force felt: free, in which the tool tracks its desired position;
approach, in which that position moves into the surface; and push, in which the position counts across the normal only
and the force along it is controlled.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.arm_kinematics import arm_kinematics
from aerotact.dynamics.reduced import Reduced
from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.mpc.arm_state import add_arm_state
from aerotact.mpc.contact_targets import FORCE_WANTED
from aerotact.ports import BlockBuilder, Layout, Port


def _ports(model: Reduced) -> tuple[Port, ...]:
    """What a stage is told."""
    return (
        Port("f_ext_W", 3, "N", "W"),
        Port("tau_ext_B", 3, "N m", "B"),
        Port("n_W", 3, "1", "W"),
        Port("p_WB_d", 3, "m", "W"),
        Port("q_WB_d", 4, "1", "W", kind="quaternion"),
        Port("v_WB_d", 3, "m/s", "W"),
        Port("p_tools_d", model.tools, "m", "W"),
        Port("push", 1, "1"),
        Port("offset", 1, "m"),
        Port("f_push", 1, "N"),
        Port("thrust_trim", 1, "N"),
        Port("torque_trim", 3, "N m", "B"),
        Port("joint_d", model.joints, "rad"),
        Port("servo_shift", model.full.servos, "rad"),
    )


def add_arm_targets(
    b: BlockBuilder, model: Reduced, times: list[float], rate: float, delay: float = 0.0
) -> tuple[Any, list[list[Any]], Layout, list[tuple[Port, Any]]]:
    """Declare ports, parameters and memory, and compute the targets.

    Args:
        b: of the block of targets.
        model: the predictor.
        times: nodes, s.
        rate: Hz.
        delay: s from the measurement to x_0, through which the robot is predicted as held.

    Returns:
        x_0, the stage parameters of every node, their layout, telemetry.
    """
    nodes, first = len(times), model.arms[0]
    at = model.state.unpack(model.hover_state)
    base = _reference(b, "p_WB_r", "m", "position of the base", nodes, at["p_WB"])
    v_base = _reference(b, "v_WB_r", "m/s", "velocity of the base", nodes)
    yaw = b.reference("yaw_r", 1, "rad", doc="yaw of the base", nodes=nodes)
    goals = [_goals(b, model, name, base, yaw, nodes) for name in model.arms]
    push = _reference(b, f"f_{first}_d", "N", "force on the environment; 0 wants none", nodes)
    posture = b.parameter("joint_d", model.joints, "rad", at["joint"], doc="posture that the working arms return to")
    parked = ca.DM(model.full.hover_servo)
    if model.joints < model.full.servos:
        parked = b.parameter("servo_d", model.full.servos, "rad", model.full.hover_servo, doc="servos of arms at rest")

    speed = b.parameter("approach_speed", 1, "m/s", 0.06, doc="of the tool towards the surface", lower=0.0)
    lead = b.parameter("approach_lead", 1, "m", 0.03, doc="of the desired position before the tool", lower=0.0)
    force_rate = b.parameter("force_rate", 1, "N/s", 4.0, doc="highest rate of the force wanted", lower=0.0)

    strength = [ca.sqrt(ca.sumsqr(push[:, k]) + 1e-12) for k in range(nodes)]
    n_kept = b.state("n_W", 3, "1", default=(0.0, 0.0, -1.0), doc="normal of the surface pushed last")
    wanted = strength[0] > FORCE_WANTED
    n_W = ca.if_else(wanted, -push[:, 0] / strength[0], n_kept)
    b.update("n_W", n_W)
    tool = goals[0]
    now = add_arm_state(b, model, rate, n_W, wanted)
    p_now = model.tool_positions(now.x)[0:3]

    p_held = b.state("p_contact_W", 3, "m", frame="W", doc="where contact was made")
    p_contact = ca.if_else(now.touched, p_held, p_now)
    b.update("p_contact_W", p_contact)

    ahead = b.state("ahead", 1, "m", doc="how far the desired position has moved into the surface")
    approaching = ca.logic_and(wanted, ca.logic_not(now.pushing))
    reach = ca.dot(n_W, tool[:, 0] - p_now) + lead
    moved = approaching * ca.fmax(ca.fmin(ahead + speed / rate, reach), 0)
    b.update("ahead", moved)

    aim = b.state("f_push", 1, "N", doc="force wanted now")
    start = ca.if_else(now.touched, aim, ca.fmax(now.force, 0))
    b.update("f_push", ca.if_else(now.pushing, _limited(start, strength[0], force_rate / rate), 0))

    # The servos yield to what deflects the springs beyond the static load, as far as it is quick, so that links do not
    # ring; what is steady stays. Arms that do not work go where they are sent.
    yielding = b.parameter("yielding", 1, "rad/s", 1.0, doc="bandwidth up to which the servos do not yield", lower=0.0)
    kept = b.state("beyond", model.joints, "rad", doc="steady part of the servo angles beyond the static load")
    beyond = kept + first_order_gain(yielding, 1 / rate) * (now.servo - model.holding_servo(now.x, n_W) - kept)
    b.update("beyond", beyond)
    shift = ca.SX(parked - ca.DM(model.full.hover_servo))
    shift[model.working.tolist()] = beyond

    R_WB = so3.rotation(now.x[3:7])
    ports, columns, aimed = _ports(model), [], ca.SX(0)
    for k, time in enumerate(times):
        f_push = now.pushing * _limited(start, strength[k], force_rate * time)
        goal = ca.if_else(now.pushing, p_contact, tool[:, k] - (moved + approaching * speed * time) * n_W)
        up = model.hover_thrust - ca.dot(R_WB[:, 2], now.f_ext_W + f_push * n_W)
        torque = ca.DM(model.hover_torque) - now.tau_ext_B
        values = {
            **{"f_ext_W": now.f_ext_W, "tau_ext_B": now.tau_ext_B, "n_W": n_W},
            **{"p_WB_d": base[:, k], "q_WB_d": _heading(yaw[k]), "v_WB_d": v_base[:, k]},
            "p_tools_d": ca.vertcat(goal, *[other[:, k] for other in goals[1:]]),
            **{"push": now.pushing, "offset": ca.dot(n_W, p_now), "f_push": f_push},
            **{"thrust_trim": up, "torque_trim": torque, "joint_d": posture, "servo_shift": shift},
        }
        columns.append([values[port.name] for port in ports])
        if k == 0:
            aimed = f_push
    telemetry: list[tuple[Port, Any]] = [
        (Port("p_WE_est", 3, "m", "W", "estimated position of the tool"), p_now),
        (Port("force_est", 1, "N", doc="estimated force of the surface along its normal"), now.force),
        (Port("f_push", 1, "N", doc="force wanted now"), aimed),
        (Port("pushing", 1, "1", doc="1 while force is controlled", kind="flag"), now.pushing),
        (Port("f_ext_est_W", 3, "N", "W", "estimated force on the base"), now.f_ext_W),
        (Port("tau_ext_est_B", 3, "N m", "B", "estimated torque on the base"), now.tau_ext_B),
    ]
    if not delay:
        return now.x, columns, Layout(ports), telemetry
    first_column = dict(zip((port.name for port in ports), columns[0], strict=True))
    holding = ca.vertcat(first_column["thrust_trim"], first_column["torque_trim"], ca.SX.zeros(model.joints + 1))
    x0 = _ahead(model, now.x, holding, ca.vertcat(now.f_ext_W, now.tau_ext_B, n_W), delay)
    return x0, columns, Layout(ports), telemetry


def _ahead(model: Reduced, x: Any, u: Any, p: Any, time: float) -> Any:
    """x after `time` s under held controls, one Runge-Kutta step of order four."""
    arms = model.arms_at(x)

    def slope(state: Any) -> Any:
        return model.derivative(state, u, p, arms)

    k1 = slope(x)
    k2 = slope(x + time / 2 * k1)
    k3 = slope(x + time / 2 * k2)
    k4 = slope(x + time * k3)
    after = x + time / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.vertcat(after[0:3], so3.unit(after[3:7]), after[7:])


def _reference(b: BlockBuilder, name: str, unit: str, doc: str, nodes: int, default: Any = (0.0, 0.0, 0.0)) -> Any:
    start = tuple(float(v) for v in default)
    return b.reference(name, 3, unit, frame="W", doc=doc, nodes=nodes, default=start)


def _goals(b: BlockBuilder, model: Reduced, name: str, base: Any, yaw: Any, nodes: int) -> Any:
    """Goals of an arm's tool in W, (3, nodes): given there, or in frame i of the base as it should stand."""
    arm = arm_kinematics(model.robot, name)
    swing = float(model.full.hover_joint[0]) if model.passive else 0.0
    q = model.full.hover_joint[model.passive :][model.full.arm_slice(name)]
    start = tuple(float(v) for v in ca.DM(arm.forward(ca.DM(q))).full().ravel())
    p_d = _reference(b, f"p_{name}_d", "m", f"goal of arm '{name}' in W", nodes)
    r_d = b.reference(f"r_{name}_d", 3, "m", doc=f"goal of arm '{name}' in frame i", nodes=nodes, default=start)
    in_W = b.reference(f"in_W_{name}", 1, "1", kind="flag", doc="1 if the goal in W counts, 0 if that in frame i")
    steered = b.reference(f"operated_{name}", 1, "1", kind="flag", doc="1 while an operator gives that in W")
    standing = [arm.from_shoulder(base[:, k], _heading(yaw[k]), swing, r_d[:, k]) for k in range(nodes)]
    there = ca.logic_or(in_W > 0, steered > 0)
    return ca.horzcat(*[ca.if_else(there, p_d[:, k], beside) for k, beside in enumerate(standing)])


def _limited(start: Any, goal: Any, change: Any) -> Any:
    return start + ca.fmin(ca.fmax(goal - start, -change), change)


def _heading(yaw: Any) -> Any:
    """The level attitude with that yaw."""
    return ca.vertcat(ca.cos(yaw / 2), 0, 0, ca.sin(yaw / 2))
