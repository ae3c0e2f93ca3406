"""contact_observer: contact of the tool with a surface, its friction, and what else pushes the robot.

The tool's force is measured, so that the residuals of force and torque can be cleared of it: what is left is the
disturbance, errors of the rotors' model included. A push on the tool away from every surface is a disturbance, too. In
contact, the disturbance along the normal is found from the tip instead, much faster: the tip does not accelerate along
it (though the body may, where the push has a lever arm), and each newton of it is an error of the contact force. A tip
that strikes or bounces does accelerate: then the slower estimate holds.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.contact import tangential
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import add_base
from aerotact.estimation.force_sensor import without_weight, wrench_at_tip
from aerotact.estimation.momentum_observer import add_rotor_wrench
from aerotact.estimation.wrench_observer import first_order_gain, specific_force_at_com
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder

FRICTION_RANGE = (0.0, 1.5)
SLIDING = 0.02  # m/s; slower motion says nothing about friction
LOADED = 0.5  # N; neither does a smaller normal force


def contact_observer(model: Model, rate: float) -> Block:
    """Contact, friction and disturbance at `rate` Hz.

    Force: the residual m s_C - f_rotors - f_tip, s_C being the specific force at the centre of mass, through a
    first-order filter of bandwidth L; torque: that of the angular momentum, bandwidth K_I (ryll2019 (19), (23) less the
    tip's wrench). Contact begins when the low-passed normal force exceeds `contact_force` within `contact_distance` of
    the surface seen. It ends after `lost_time` below `lost_force` or beyond that distance: a sensor that drifts must
    not hold a contact in free flight. The coefficient of friction follows the ratio of the forces while the tip
    slides.

    While `calibrate` is 1 (contact-free hover) the mean reading of the force sensor is learnt, and held while it is 0.

    Raises:
        MissingCapability: the robot has no tool or no force/torque sensor.
    """
    model.require(["tool", "force_torque"], "estimator contact_observer")
    robot, period = model.robot, 1.0 / rate
    b = BlockBuilder("contact_observer", "aerotact", rate, "contact, friction and disturbance beside the tool's force")
    base = add_base(b, model)
    specific_force_B = b.measurement(
        "specific_force_B", 3, "m/s^2", frame="B", doc="at the IMU, bias removed", default=(0.0, 0.0, robot.gravity)
    )
    rotors, _ = add_rotor_wrench(b, model)
    f_S = b.measurement("f_sensor_S", 3, "N", frame="S", doc="sensor's force, by the robot, with the tool's weight")
    tau_S = b.measurement("tau_sensor_S", 3, "N m", frame="S", doc="sensor's torque, by the robot, about its origin")
    seen_n = b.measurement("n_W", 3, "1", frame="W", doc="unit normal of the surface, towards the robot")
    distance = b.measurement("surface_distance", 1, "m", doc="from the tip to the surface along the tool's axis")
    valid = b.measurement("surface_valid", 1, "1", kind="flag", doc="1 if a surface is seen")
    calibrate = b.reference("calibrate", 1, "1", kind="flag", doc="1 in contact-free hover: learn the tare")

    L = b.parameter("L", 1, "rad/s", 40.0, doc="bandwidth of the disturbance force", lower=0.0)
    K_I = b.parameter("K_I", 1, "rad/s", 20.0, doc="bandwidth of the disturbance torque", lower=0.0)
    L_normal = b.parameter("L_normal", 1, "rad/s", 100.0, doc="the same along the normal in contact", lower=0.0)
    low_pass = b.parameter("low_pass", 1, "Hz", 20.0, doc="cut-off of the normal force", lower=0.0)
    friction_rate = b.parameter("friction_rate", 1, "rad/s", 3.0, doc="bandwidth of the friction", lower=0.0)
    contact_force = b.parameter("contact_force", 1, "N", 0.8, doc="that begins a contact", lower=0.0)
    contact_distance = b.parameter("contact_distance", 1, "m", 0.012, doc="beyond which there is none", lower=0.0)
    lost_force = b.parameter("lost_force", 1, "N", 0.1, doc="below which a contact ends", lower=0.0)
    lost_time = b.parameter("lost_time", 1, "s", 0.2, doc="for which it must stay so or away", lower=0.0)

    settle_time = b.parameter(
        "settle_time", 1, "s", 0.02, doc="of unbroken force after which the tip counts as resting", lower=0.0
    )

    started = b.state("started", 1, "1", kind="flag", doc="1 after the first step") > 0
    tare = b.state("tare_S", 6, "N", frame="S", doc="learnt reading without contact, force N and torque N m")
    samples = b.state("tare_samples", 1, "1", doc="samples in the tare's mean")
    f_dist = b.state("f_dist_W", 3, "N", frame="W", doc="disturbance force")
    tau_dist = b.state("tau_dist_B", 3, "N m", frame="B", doc="disturbance torque about the centre of mass")
    f_tool = b.state("f_tool_W", 3, "N", frame="W", doc="force on the tool, filtered as the disturbance")
    tau_tool = b.state("tau_tool_B", 3, "N m", frame="B", doc="its torque about the centre of mass")
    spin_before = b.state("spin_B", 3, "N m s", frame="B", doc="angular momentum one step ago")
    torque_before = b.state("torque_B", 3, "N m", frame="B", doc="known torque one step ago")
    f_normal_dist = b.state("f_normal_dist", 1, "N", doc="disturbance along the normal, from a tip that rests")
    held_n = b.state("n_W", 3, "1", frame="W", doc="normal seen last", default=(0.0, 0.0, 1.0))
    normal = b.state("normal_force", 1, "N", doc="low-passed normal force")
    contact = b.state("contact", 1, "1", kind="flag", doc="1 in contact") > 0
    pressed = b.state("pressed", 1, "s", doc="time of unbroken force in contact")
    lost = b.state("lost", 1, "s", doc="time below lost_force or away")
    friction = b.state("friction", 1, "1", doc="coefficient of friction", default=(0.4,))

    # the tool's wrench, of the environment on the robot
    R_WB = so3.rotation(base.q_WB)
    reading = ca.vertcat(*without_weight(model, f_S, tau_S, base.q_WB))
    learning = calibrate > 0
    count = samples * learning + 1
    tare_next = tare + learning / count * (reading - tare)
    f_B, tau_B = (-part for part in wrench_at_tip(model, *ca.vertsplit(reading - tare_next, 3)))
    f_tip_W = ca.mtimes(R_WB, f_B)
    p_CE = ca.DM(robot.p_BE - robot.p_BC)
    tau_tip_B = tau_B + ca.cross(p_CE, f_B)

    # disturbance
    J = ca.sparsify(ca.DM(np.where(np.abs(robot.J_C) < 1e-15, 0.0, robot.J_C)))
    spin = ca.mtimes(J, base.w_B)
    torque = rotors[3:6] + tau_tip_B - ca.cross(base.w_B, spin)
    gained = ca.if_else(started, (spin - spin_before) * rate - (torque + torque_before) / 2, 0)
    tau_next = tau_dist + first_order_gain(K_I, period) * (gained - tau_dist)
    dw_B = ca.mtimes(model.inverse_inertia, torque + tau_next)
    s_C_B = specific_force_at_com(model, specific_force_B, base.w_B, dw_B)
    f_rotors_W = ca.mtimes(R_WB, rotors[0:3])
    f_residual = robot.mass * ca.mtimes(R_WB, s_C_B) - f_rotors_W - f_tip_W
    f_next = f_dist + first_order_gain(L, period) * (f_residual - f_dist)
    f_tool_next = f_tool + first_order_gain(L, period) * (f_tip_W - f_tool)
    tau_tool_next = tau_tool + first_order_gain(K_I, period) * (tau_tip_B - tau_tool)

    # contact
    n = ca.if_else(valid > 0, seen_n, held_n)
    z_E = so3.rotation(so3.product(base.q_WB, ca.DM(model.q_BE)))[:, 2]
    felt = ca.dot(n, f_tip_W)
    normal_next = normal + first_order_gain(2 * np.pi * low_pass, period) * (felt - normal)
    within = -distance * ca.dot(n, z_E) < contact_distance
    near = ca.logic_and(valid > 0, within)
    begins = ca.logic_and(near, normal_next > contact_force)
    away = ca.logic_and(valid > 0, ca.logic_not(within))
    lost_next = ca.if_else(ca.logic_or(normal_next < lost_force, away), lost + period, 0)
    contact_next = ca.if_else(contact, lost_next < lost_time, begins)

    # the tip's acceleration by all that is known but a disturbance force: one along n makes it 1/m larger a newton
    turning = ca.cross(dw_B, p_CE) + ca.cross(base.w_B, ca.cross(base.w_B, p_CE))
    a_known_W = (f_rotors_W + f_tip_W) / robot.mass - ca.DM([0, 0, robot.gravity]) + ca.mtimes(R_WB, turning)
    balance = -robot.mass * ca.dot(n, a_known_W)
    along = ca.dot(n, f_next)
    pressed_next = ca.if_else(ca.logic_and(contact_next, felt > lost_force), pressed + period, 0)
    f_normal_next = ca.if_else(
        pressed_next > settle_time,
        f_normal_dist + first_order_gain(L_normal, period) * (balance - f_normal_dist),
        along,
    )
    apart = ca.logic_not(ca.logic_or(contact_next, near))
    f_out = f_next + (f_normal_next - along) * n + apart * f_tool_next
    tau_out = tau_next + apart * tau_tool_next

    # friction
    v_WE = base.v_WB + ca.mtimes(R_WB, ca.cross(base.w_B, ca.DM(robot.p_BE)))
    sliding = tangential(n, v_WE)
    speed = ca.sqrt(ca.sumsqr(sliding) + 1e-12)
    ratio = -ca.dot(f_tip_W, sliding) / speed / ca.fmax(normal_next, LOADED)
    tells = ca.logic_and(contact_next, ca.logic_and(speed > SLIDING, normal_next > LOADED))
    friction_next = friction + tells * first_order_gain(friction_rate, period) * (ratio - friction)
    friction_next = ca.fmin(ca.fmax(friction_next, FRICTION_RANGE[0]), FRICTION_RANGE[1])

    updates: dict[str, Any] = {
        "started": 1,
        "tare_S": tare_next,
        "tare_samples": count * learning,
        "f_dist_W": f_next,
        "tau_dist_B": tau_next,
        "f_tool_W": f_tool_next,
        "tau_tool_B": tau_tool_next,
        "spin_B": spin,
        "torque_B": torque,
        "f_normal_dist": f_normal_next,
        "n_W": n,
        "normal_force": normal_next,
        "contact": contact_next,
        "lost": lost_next,
        "pressed": pressed_next,
        "friction": friction_next,
    }
    for name, value in updates.items():
        b.update(name, value)
    b.output("f_dist_W", f_out, "N", frame="W", doc="disturbance force on the robot, the tool's contact excluded")
    b.output("tau_dist_B", tau_out, "N m", frame="B", doc="its torque about the centre of mass")
    b.output("f_tip_W", f_tip_W, "N", frame="W", doc="force of the environment on the tip, unfiltered")
    b.output("normal_force", normal_next, "N", doc="its low-passed part along the surface's normal")
    b.output("contact", contact_next, "1", kind="flag", doc="1 if the tip is at the surface")
    b.output("friction", friction_next, "1", doc="coefficient of friction")
    return with_robot_gains(b.build(), robot)


ESTIMATORS = {"contact_observer": contact_observer}
