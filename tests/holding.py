"""A plain law of the tests for any robot with six axes, tilting or not: hold the base at a place, level."""

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.dynamics.rotors import least_thrust
from aerotact.ports import Block, BlockBuilder


def hold(model: Model, rate: float) -> Block:
    """Spring and damper to the place, against the estimated wrench; tilts as they come."""
    robot = model.robot
    model.require(["six_axis_wrench", "tool"], "law hold")
    b = BlockBuilder("hold", "example", rate, "spring and damper of the base")
    p_WB = b.measurement("p_WB", 3, "m", frame="W", doc="position of the base", default=tuple(model.hover_state[:3]))
    q_WB = b.measurement("q_WB", 4, "1", frame="W", doc="attitude of the base", kind="quaternion")
    v_WB = b.measurement("v_WB", 3, "m/s", frame="W", doc="velocity of the base")
    w_B = b.measurement("w_B", 3, "rad/s", frame="B", doc="angular velocity of the base")
    f_ext_W = b.measurement("f_ext_W", 3, "N", frame="W", doc="force of the environment")
    tau_ext_B = b.measurement("tau_ext_B", 3, "N m", frame="B", doc="its torque about the centre of mass")
    p_WE_d = b.reference("p_WE_d", 3, "m", frame="W", doc="place of the tool", default=tuple(model.hover_tool[0]))
    stiffness = b.parameter("stiffness", 1, "1/s^2", 4.0, doc="of position, a kilogram")
    a_W = stiffness * (p_WE_d - ca.DM(robot.p_BE) - p_WB) - 2 * ca.sqrt(stiffness) * v_WB
    f_W = robot.mass * (a_W + ca.DM([0, 0, robot.gravity])) - f_ext_W
    tau_B = ca.mtimes(ca.DM(robot.J_C), -30 * so3.to_chart(q_WB) - 10 * w_B) - tau_ext_B
    thrust, tilt = least_thrust(robot, ca.vertcat(ca.mtimes(so3.rotation(q_WB).T, f_W), tau_B))
    for port, value in zip(model.commands, (thrust, tilt), strict=False):
        b.output(port.name, value, port.unit, doc=port.doc, default=port.default)
    b.limit_with(actuator_limiter(model, rate))
    return b.build()
