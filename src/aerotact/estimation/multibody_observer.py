"""multibody_observer: the wrench of the environment on a robot with joints, from the momentum of all its bodies.

With P and H the momentum of all bodies, linear and angular about the base's origin, both in W,

    dP/dt = R f_rotors - m g e_z + f_ext,    dH/dt = R tau_rotors - m p_BC x g e_z - v_WB x P + tau_ext,

so the joints' torques drop out: what arms and pendulum do to the base is no wrench of the environment. As in
momentum_observer (bodie2021 (5)-(6)) nothing is differentiated but what then passes a first-order filter.
"""

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import add_base, numbers
from aerotact.estimation.joint_estimator import require_joints
from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder


def multibody_observer(model: Model, rate: float) -> Block:
    """Force, and torque about the base's origin, of the environment on the whole robot; slow, against a steady push.

    Raises:
        MissingCapability: the robot has no joints.
        RobotError: a joint that nothing measures.
    """
    arms = require_joints(model, "estimator multibody_observer")
    robot, period = arms.robot, 1.0 / rate
    b = BlockBuilder("multibody_observer", "aerotact", rate, "external wrench from the momentum of all bodies")
    f_hat = b.state("f_ext_W", 3, "N", frame="W", doc="estimated force")
    tau_hat = b.state("tau_ext_W", 3, "N m", frame="W", doc="estimated torque about the base's origin")
    names = ("momentum_W", "spin_W", "f_known_W", "tau_known_W")
    units = ("N s", "N m s", "N", "N m")
    before = [b.state(n, 3, u, frame="W", doc="one step ago") for n, u in zip(names, units, strict=True)]
    started = b.state("started", 1, "1", kind="flag", doc="1 after the first step") > 0
    base = add_base(b, arms)
    joint = b.measurement("joint", arms.joints, "rad", doc="joint angles", default=tuple(arms.hover_joint))
    joint_rate = b.measurement("joint_rate", arms.joints, "rad/s", doc="rates of the joint angles")
    thrust = b.measurement(
        "thrust_measured", arms.rotors, "N", doc="actual thrusts", default=numbers(robot.hover_thrust)
    )
    K_lin = b.parameter("K_I_lin", 3, "rad/s", 1.0, frame="W", doc="bandwidth of the force", lower=0.0)
    K_ang = b.parameter("K_I_ang", 3, "rad/s", 1.0, frame="W", doc="bandwidth of the torque", lower=0.0)

    R_WB, M = so3.rotation(base.q_WB), arms.bodies.mass_matrix(joint)
    v_B = ca.mtimes(R_WB.T, base.v_WB)
    momentum = ca.mtimes(M[0:6, :], ca.vertcat(v_B, base.w_B, joint_rate))
    P_W, H_W = ca.mtimes(R_WB, momentum[0:3]), ca.mtimes(R_WB, momentum[3:6])
    f_B, tau_B = arms.rotor_wrench(thrust)
    weight_B = robot.gravity * R_WB[2, :].T
    f_known = ca.mtimes(R_WB, f_B) - ca.DM([0, 0, robot.mass * robot.gravity])
    tau_known = ca.mtimes(R_WB, tau_B - ca.mtimes(M[3:6, 0:3], weight_B)) - ca.cross(base.v_WB, P_W)
    now = [P_W, H_W, f_known, tau_known]

    f_residual = (P_W - before[0]) * rate - (f_known + before[2]) / 2
    tau_residual = (H_W - before[1]) * rate - (tau_known + before[3]) / 2
    f_next = f_hat + first_order_gain(K_lin, period) * ca.if_else(started, f_residual - f_hat, 0)
    tau_next = tau_hat + first_order_gain(K_ang, period) * ca.if_else(started, tau_residual - tau_hat, 0)
    b.update("f_ext_W", f_next)
    b.update("tau_ext_W", tau_next)
    for name, value in zip(names, now, strict=True):
        b.update(name, value)
    b.update("started", 1)
    b.output("f_ext_W", f_next, "N", frame="W", doc="force of the environment on the robot")
    b.output(
        "tau_ext_B",
        ca.mtimes(R_WB.T, tau_next),
        "N m",
        frame="B",
        doc="torque of the environment about the base's origin",
    )
    return with_robot_gains(b.build(), robot)


ESTIMATORS = {"multibody_observer": multibody_observer}
