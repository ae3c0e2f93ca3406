"""momentum_observer: the wrench of the environment on the robot from momentum alone, without an accelerometer.

bodie2021 (5)-(6) with the erratum of (5). Its ports are those of wrench_observer, so that either can serve a law.
"""

from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion, add_base, com_motion, numbers
from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder


def add_rotor_wrench(b: BlockBuilder, model: Model) -> tuple[Any, Any]:
    """Ports of the measured thrusts and tilts, and the wrench that they make.

    The paper takes the commanded wrench for the actual one; measured, it holds under saturation and lag too.

    Returns:
        Force, N, and torque about the centre of mass, N m, in B, (6,); tilt angles, rad, (m,).
    """
    robot = model.robot
    thrust = b.measurement(
        "thrust_measured", model.rotors, "N", doc="actual thrusts", default=numbers(robot.hover_thrust)
    )
    tilt = None
    if model.tilts:
        tilt = b.measurement(
            "tilt_measured", model.tilts, "rad", doc="actual tilt angles", default=numbers(robot.hover_tilt)
        )
    return ca.vertcat(*model.rotor_wrench(thrust, tilt)), tilt


def add_momentum_observer(b: BlockBuilder, model: Model, rate: float, base: BaseMotion, wrench: Any) -> tuple[Any, Any]:
    """States, gains and equations (5)-(6) of bodie2021.

    With p the momentum and tau_act what rotors, weight and rotation explain, (5) as corrected is
    tau_hat = K_I (p - p_0 - int(tau_act + tau_hat) dt): a first-order filter of p' - tau_act. Over one step the change
    of p is exact and tau_act the mean of its ends, so that nothing is differentiated; the filter is solved exactly, and
    a constant wrench is approached as exp(-K_I t) at any rate. The first step gives zero.

    Args:
        b: takes the states and the parameters K_I_lin and K_I_ang.
        model: gives mass, inertia and centre of mass.
        rate: Hz.
        base: measured motion of the base.
        wrench: of the rotors, (6,), force in N and torque about the centre of mass in N m, in B.

    Returns:
        f_ext_B, N, and tau_ext_B about the centre of mass, N m: of the environment on the robot, in B.
    """
    robot, period = model.robot, 1.0 / rate
    f_hat = b.state("f_ext_B", 3, "N", frame="B", doc="estimated force on the robot")
    tau_hat = b.state("tau_ext_B", 3, "N m", frame="B", doc="estimated torque about the centre of mass")
    before = [
        b.state("momentum_W", 3, "N s", frame="W", doc="momentum one step ago"),
        b.state("spin_B", 3, "N m s", frame="B", doc="angular momentum one step ago"),
        b.state("f_known_W", 3, "N", frame="W", doc="known force one step ago"),
        b.state("tau_known_B", 3, "N m", frame="B", doc="known torque one step ago"),
    ]
    observed = b.state("observed", 1, "1", kind="flag", doc="1 after the observer's first step")
    K_lin = b.parameter("K_I_lin", 3, "rad/s", 3.0, frame="B", doc="bandwidth of the force observer, (5)", lower=0.0)
    K_ang = b.parameter("K_I_ang", 3, "rad/s", 3.0, frame="B", doc="bandwidth of the torque observer, (5)", lower=0.0)

    R_WB = so3.rotation(base.q_WB)
    _, v_WC, _ = com_motion(model, base)
    J = ca.sparsify(ca.DM(np.where(np.abs(robot.J_C) < 1e-15, 0.0, robot.J_C)))
    momentum, spin = robot.mass * v_WC, ca.mtimes(J, base.w_B)
    f_known = ca.mtimes(R_WB, wrench[0:3]) - robot.mass * ca.DM([0, 0, robot.gravity])
    tau_known = wrench[3:6] - ca.cross(base.w_B, spin)
    now = [momentum, spin, f_known, tau_known]

    f_residual = ca.mtimes(R_WB.T, (momentum - before[0]) * rate - (f_known + before[2]) / 2)
    tau_residual = (spin - before[1]) * rate - (tau_known + before[3]) / 2
    running = observed > 0
    f_next = f_hat + first_order_gain(K_lin, period) * ca.if_else(running, f_residual - f_hat, 0)
    tau_next = tau_hat + first_order_gain(K_ang, period) * ca.if_else(running, tau_residual - tau_hat, 0)

    b.update("f_ext_B", f_next)
    b.update("tau_ext_B", tau_next)
    for name, value in zip(("momentum_W", "spin_B", "f_known_W", "tau_known_B"), now, strict=True):
        b.update(name, value)
    b.update("observed", 1)
    return f_next, tau_next


def momentum_observer(model: Model, rate: float) -> Block:
    """Wrench observer of bodie2021 (5)-(6) at `rate` Hz; the wrench is that of the environment on the robot.

    Raises:
        MissingCapability: the robot is no rigid body.
    """
    model.require(["rigid_body"], "estimator momentum_observer")
    b = BlockBuilder("momentum_observer", "bodie2021", rate, "external wrench from momentum and rotor wrench (5)-(6)")
    base = add_base(b, model)
    wrench, _ = add_rotor_wrench(b, model)
    f_B, tau_B = add_momentum_observer(b, model, rate, base, wrench)
    f_W = ca.mtimes(so3.rotation(base.q_WB), f_B)
    b.output("f_ext_W", f_W, "N", frame="W", doc="force of the environment on the robot")
    b.output("tau_ext_B", tau_B, "N m", frame="B", doc="torque of the environment on the robot about its COM")
    return with_robot_gains(b.build(), model.robot)


ESTIMATORS = {"momentum_observer": momentum_observer}
