"""Kinematics and statics of an arm, and the model with joints, in generated C: equal to CasADi and as asked."""

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from native import Native, evaluate

from aerotact.codegen.project import CProject, block_project
from aerotact.dynamics import so3
from aerotact.dynamics.arm_kinematics import arm_kinematics
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.ports import Block, BlockBuilder
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
RATE = 50.0


@pytest.fixture(scope="module")
def arms() -> Multibody:
    model = model_of(load_robot(MODELS / "dual_arm_long_reach"))
    assert isinstance(model, Multibody)
    return model


@pytest.fixture(scope="module")
def reach(arms: Multibody) -> Block:
    """From encoders and a wanted place of the left tool: servo angles that hold it there, and the stiffness it has."""
    left = arm_kinematics(arms.robot, "left")
    b = BlockBuilder("arm_reach", "suarez2020", RATE, "servo angles that hold the tool in place")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion")
    swing = b.measurement("passive_measured", 1, "rad")
    deflection = b.measurement("deflection_measured", 2, "rad")
    servo = b.measurement("servo_measured", 8, "rad", default=tuple(arms.hover_servo))
    goal = b.reference("r_left", 3, "m", default=(0.25, 0.0, -0.25))
    roll = b.parameter("roll", 1, "rad", 0.1)
    _, R_BS = left.shoulder_pose(swing)
    up = ca.mtimes(R_BS.T, so3.rotation(q_WB)[2, :].T)
    q = left.inverse(goal, roll)
    measured = ca.vertcat(servo[0] - deflection[0], servo[1:3], servo[3] - deflection[1])
    b.output("joint", q, "rad")
    b.output("servo", left.servo_for(q, left.gravity_torque(q, arms.robot.gravity * up)), "rad")
    b.output("r_measured", left.forward(measured), "m")
    b.output("stiffness", ca.vec(left.cartesian_stiffness(measured, (0, 2), (0, 3))), "N/m")
    return b.build()


def test_reach_in_c(arms: Multibody, reach: Block, native: Callable[[CProject], Native]) -> None:
    library = native(block_project(reach, arms))
    said = arms.sensed(ca.DM(arms.hover_state))
    y = reach.measurement.pack({name: said[name].full() for name in ("passive_measured", "deflection_measured")})
    rng, left = np.random.default_rng(1), arm_kinematics(arms.robot, "left")
    for trial in range(30):
        goal = np.array([0.25, 0.0, -0.25]) + (0.0 if trial == 0 else rng.uniform(-0.04, 0.04, 3))
        p = np.array([0.0 if trial == 0 else rng.uniform(0.0, 0.2)])
        inputs = [np.zeros(0), y, goal, p]
        got, expected = (f("arm_reach_law", reach.step, inputs) for f in (library, _evaluate))
        np.testing.assert_allclose(got[1], expected[1], rtol=1e-12, atol=1e-14)
        out = reach.output.unpack(got[1])
        np.testing.assert_allclose(left.forward(ca.DM(out["joint"])).full().ravel(), goal, atol=1e-12)
        if trial == 0:  # the pose of hover
            np.testing.assert_allclose(out["servo"], arms.hover_servo[:4], atol=1e-12)
            np.testing.assert_allclose(out["r_measured"], goal, atol=1e-12)


def _evaluate(_: str, function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    return evaluate(function, inputs)


def test_dynamics_in_c(arms: Multibody, native: Callable[[CProject], Native]) -> None:
    """The equations of motion as a block: no loops and no calls of a library are left in them."""
    b = BlockBuilder("joint_dynamics", "suarez2020", RATE, "(13) as it stands")
    x, u, p = (b.reference(n, layout.size, "1") for n, layout in zip("xup", arms.layouts, strict=True))
    b.output("xdot", arms.derivative(x, u, p), "1")
    block = b.build()
    library = native(block_project(block, arms))
    rng = np.random.default_rng(2)
    for _ in range(10):
        values = [arms.hover_state + 0.1 * rng.normal(size=arms.state.size), *(rng.normal(size=n) for n in (14, 12))]
        inputs = [np.zeros(0), np.zeros(0), np.concatenate(values), np.zeros(0)]
        got = library("joint_dynamics_law", block.step, inputs)[1]
        expected = arms.function(*values).full().ravel()
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
        assert np.abs(expected).max() > 1.0
