"""Targets: from measurement, reference and parameters to the stage parameters of an OCP, once a period.

This is the OCP's only memory: the state of the virtual mass-spring-damper, advanced one period a step and predicted
over the horizon with the estimated wrench held, so that the tool is told where it will have to yield.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import admittance as adm
from aerotact.dynamics import so3
from aerotact.dynamics.contact import tool_wrench
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import base_reference
from aerotact.dynamics.reduced import Reduced
from aerotact.dynamics.rotors import least_thrust
from aerotact.laws.bodie2021.impedance import add_impedance
from aerotact.mpc.arm_targets import add_arm_targets
from aerotact.mpc.contact_targets import CONTACT_PORTS, add_contact
from aerotact.mpc.prediction import ahead
from aerotact.ports import Array, Block, BlockBuilder, Layout, Port

BASE_PORTS = (
    Port("p_WB_d", 3, "m", "W"),
    Port("q_WB_d", 4, "1", "W", kind="quaternion"),
    Port("v_WB_d", 3, "m/s", "W"),
    Port("w_B_d", 3, "rad/s", "B"),
    Port("a_WB_d", 3, "m/s^2", "W"),
    Port("dw_B_d", 3, "rad/s^2", "B"),
)


@dataclass(frozen=True)
class Targets:
    """The block that prepares a solve.

    Attributes:
        block: outputs `x0`, then `stage` (nodes, stage.size), then telemetry; its last measurement ports are the
            modelled actuators, which the limiter of the controller keeps.
        stage: layout of one stage's parameters.
        telemetry: layout of what is passed on for the log.
    """

    block: Block
    stage: Layout
    telemetry: Layout


def _motions(b: BlockBuilder, model: Model, nodes: int) -> list[adm.ToolMotion]:
    """The desired motion at every node, from the preview ports."""
    p_WE, q_WE = model.hover_tool
    preview: dict[str, Any] = {"nodes": nodes}
    p = b.reference("p_WE_d", 3, "m", frame="W", doc="desired tool position", default=tuple(p_WE), **preview)
    q = b.reference(
        "q_WE_d", 4, "1", frame="W", doc="desired tool attitude", kind="quaternion", default=tuple(q_WE), **preview
    )
    v = b.reference("v_WE_d", 3, "m/s", frame="W", doc="desired tool velocity", **preview)
    w = b.reference("w_E_d", 3, "rad/s", frame="E", doc="desired tool angular velocity", **preview)
    a = b.reference("a_WE_d", 3, "m/s^2", frame="W", doc="desired tool acceleration", **preview)
    dw = b.reference("dw_E_d", 3, "rad/s^2", frame="E", doc="desired tool angular acceleration", **preview)
    motions = []
    for k in range(nodes):
        R = so3.rotation(q[:, k])
        motions.append(
            adm.ToolMotion(p[:, k], q[:, k], v[:, k], ca.mtimes(R, w[:, k]), a[:, k], ca.mtimes(R, dw[:, k]))
        )
    return motions


def _admittance(b: BlockBuilder, desired: list[adm.ToolMotion], times: list[float]) -> list[adm.ToolMotion]:
    """The reference motion at every node; declares the parameters and the state of the virtual mass-spring-damper."""
    f = b.measurement("f_tool_W", 3, "N", frame="W", doc="force of the environment on the tool")
    tau = b.measurement("tau_tool_W", 3, "N m", frame="W", doc="torque of the environment on the tool")
    law, dead_force, dead_torque = adm.add_parameters(b)
    wrench = ca.vertcat(adm.dead_zone(f, dead_force), adm.dead_zone(tau, dead_torque))
    started = b.state("started", 1, "1", doc="the reference motion is set")
    kept = adm.ToolMotion(
        b.state("p_WE_r", 3, "m"),
        b.state("q_WE_r", 4, "1", kind="quaternion"),
        b.state("v_WE_r", 3, "m/s"),
        b.state("w_WE_r", 3, "rad/s"),
        None,
        None,
    )
    first = adm.ToolMotion(
        p_WE=ca.if_else(started, kept.p_WE, desired[0].p_WE),
        q_WE=ca.if_else(started, kept.q_WE, desired[0].q_WE),
        v_WE=ca.if_else(started, kept.v_WE, desired[0].v_WE),
        w_WE=ca.if_else(started, kept.w_WE, desired[0].w_WE),
        a_WE=None,
        dw_WE=None,
    )
    a, dw = adm.acceleration(law, desired[0], first, wrench)
    motions = [adm.ToolMotion(first.p_WE, first.q_WE, first.v_WE, first.w_WE, a, dw)]
    for k in range(len(times) - 1):
        h = times[k + 1] - times[k]
        motions.append(adm.advance(law, desired[k], desired[k + 1], motions[-1], wrench, h))
    b.update("started", ca.SX(1))
    for name in ("p_WE", "q_WE", "v_WE", "w_WE"):
        b.update(f"{name}_r", getattr(motions[1], name))
    return motions


def _trim(model: Model, target: adm.ToolMotion, f_ext_W: Any, tau_ext_B: Any, tilt: Any) -> dict[str, Any]:
    """Actuators of least thrust that give the target its acceleration against the estimated wrench, cut to the limits;
    tilts nearest to those given."""
    robot = model.robot
    R_WB = ca.mtimes(so3.rotation(target.q_WE), ca.DM(robot.R_BE.T))
    w_B, dw_B = ca.mtimes(R_WB.T, target.w_WE), ca.mtimes(R_WB.T, target.dw_WE)
    lever = ca.DM(robot.p_BC - robot.p_BE)
    a_WC = target.a_WE + ca.mtimes(R_WB, ca.cross(dw_B, lever) + ca.cross(w_B, ca.cross(w_B, lever)))
    f_B = ca.mtimes(R_WB.T, robot.mass * (a_WC + ca.DM([0, 0, robot.gravity])) - f_ext_W)
    J = ca.DM(robot.J_C)
    tau_B = ca.mtimes(J, dw_B) + ca.cross(w_B, ca.mtimes(J, w_B)) - tau_ext_B
    thrust, angles = least_thrust(robot, ca.vertcat(f_B, tau_B), tilt)
    trim = {"thrust": _cut(thrust, model.thrust_limits)}
    if model.tilts:
        trim["tilt"] = _cut(angles, model.tilt_limits)
    return trim


def _cut(value: Any, limits: tuple[Array, Array]) -> Any:
    lower, upper = (ca.DM(v) for v in limits)
    return ca.fmin(ca.fmax(value, lower), upper)


def _on_their_way(b: BlockBuilder, model: Model, delay: int, now: Any) -> list[Any]:
    """Actuators' values since the measurement, oldest first; declares the memory of them."""
    hover = tuple(float(v) for v in model.actuators.default)
    kept = [b.state(f"actuators_{i}", len(hover), "1", default=hover) for i in range(delay)]
    for i, later in enumerate([*kept[1:], now]):
        b.update(f"actuators_{i}", later)
    return kept


def make_targets(
    name: str,
    doc: str,
    model: Model,
    times: list[float],
    rate: float,
    uses: set[str],
    weights: list[Port],
    delay: int = 0,
) -> Targets:
    """Build the block.

    Args:
        name, doc: of the problem.
        model: of the robot.
        times: nodes, s.
        rate: Hz.
        uses: which targets the residuals need: "desired", "base", "admittance", "trim",
            "contact", "impedance".
        weights: parameter ports of the residuals' weights.
        delay: periods from a measurement to the command that answers it; nodes and modelled actuators are those of
            then, and the base is predicted through the commands that are on their way.
    """
    b = BlockBuilder(name, "aerotact", rate, doc)
    if isinstance(model, Reduced):
        for port in weights:
            b.parameter(port.name, port.size, port.unit, port.default, doc=port.doc, lower=0.0)
        return _closed(b, *add_arm_targets(b, model, times, rate, delay / rate))
    x = ca.vertcat(
        b.measurement("p_WB", 3, "m", frame="W", doc="position of the base"),
        b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion"),
        b.measurement("v_WB", 3, "m/s", frame="W", doc="velocity of the base"),
        b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base"),
    )
    # Where the contact is predicted, what is measured is the rest.
    which, rest = ("dist", ", the tool's contact excluded") if "contact" in uses else ("ext", "")
    f_ext = b.measurement(f"f_{which}_W", 3, "N", frame="W", doc=f"force of the environment on the robot{rest}")
    tau_ext = b.measurement(f"tau_{which}_B", 3, "N m", frame="B", doc="its torque about the centre of mass")
    if "impedance" in uses:
        add_impedance(b)
    for port in weights:
        b.parameter(port.name, port.size, port.unit, port.default, doc=port.doc, lower=0.0)
    desired = _motions(b, model, len(times))
    reference = _admittance(b, desired, times) if "admittance" in uses else None
    target = reference or desired

    ports = [Port("f_ext_W", 3, "N", "W"), Port("tau_ext_B", 3, "N m", "B")]
    columns: list[list[Any]] = [[f_ext, tau_ext] for _ in times]
    for suffix, motions in (("d", desired if "desired" in uses else None), ("r", reference)):
        if motions is None:
            continue
        ports += [Port(f"p_WE_{suffix}", 3, "m", "W"), Port(f"q_WE_{suffix}", 4, "1", "W", kind="quaternion")]
        ports += [Port(f"v_WE_{suffix}", 3, "m/s", "W"), Port(f"w_E_{suffix}", 3, "rad/s", "E")]
        for column, motion in zip(columns, motions, strict=True):
            w_E = ca.mtimes(so3.rotation(motion.q_WE).T, motion.w_WE)
            column += [motion.p_WE, motion.q_WE, motion.v_WE, w_E]
    if "base" in uses:
        ports += BASE_PORTS
        for column, motion in zip(columns, target, strict=True):
            base = base_reference(model, motion)
            column += [base.p_WB, base.q_WB, base.v_WB, base.w_B, base.a_WB, base.dw_B]
    expected = [(f_ext, tau_ext) for _ in times]
    telemetry: list[tuple[Port, Any]] = [
        (Port("p_WE_r", 3, "m", "W", "tool position aimed at"), target[0].p_WE),
        (Port("q_WE_r", 4, "1", "W", "tool attitude aimed at", kind="quaternion"), target[0].q_WE),
        (Port("v_WE_r", 3, "m/s", "W", "tool velocity aimed at"), target[0].v_WE),
    ]
    if "contact" in uses:
        tool = model.tool_pose(ca.vertcat(x, ca.SX.zeros(model.actuators.size)))
        contact = add_contact(b, tool, [motion.v_WE for motion in target], times, rate)
        ports += CONTACT_PORTS
        telemetry += contact.telemetry
        for k, (column, own, motion) in enumerate(zip(columns, contact.columns, target, strict=True)):
            column += own
            q_WB = so3.product(motion.q_WE, so3.conjugate(ca.DM(model.q_BE)))
            wrench = tool_wrench(model, q_WB, contact.f_tool_W[k])
            expected[k] = (f_ext + wrench[0:3], tau_ext + wrench[3:6])
    actuators = {p.name: b.measurement(p.name, p.size, p.unit, doc=f"modelled {p.name}") for p in model.actuators}
    if "trim" in uses:
        ports += [Port(f"{p.name}_trim", p.size, p.unit) for p in model.actuators]
        tilt = actuators.get("tilt")
        for column, motion, wrench in zip(columns, target, expected, strict=True):
            trim = _trim(model, motion, *wrench, tilt)
            column += [trim[p.name] for p in model.actuators]
            tilt = trim.get("tilt")
    layout = Layout(ports)
    now = ca.vertcat(*actuators.values())
    if delay:
        x0 = ahead(
            model, x, [*_on_their_way(b, model, delay, now), now], 1.0 / rate, layout.split(ca.vertcat(*columns[0]))
        )
    else:
        x0 = ca.vertcat(x, now)
    return _closed(b, x0, columns, layout, telemetry)


def _closed(
    b: BlockBuilder, x0: Any, columns: list[list[Any]], layout: Layout, telemetry: list[tuple[Port, Any]]
) -> Targets:
    """The block with its outputs."""
    b.output("x0", x0, "1")
    b.output("stage", ca.horzcat(*[ca.vertcat(*c) for c in columns]), "1")
    for port, value in telemetry:
        b.output(port.name, value, port.unit, frame=port.frame, doc=port.doc, kind=port.kind)
    return Targets(b.build(), layout, Layout(port for port, _ in telemetry))
