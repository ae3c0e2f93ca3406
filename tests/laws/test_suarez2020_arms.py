"""Equations (14)-(33) of suarez2020 beside MuJoCo, virtual work and closed forms; what the printed ones would do."""

from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.arm_kinematics import ArmKinematics, arm_kinematics
from aerotact.dynamics.multibody import Multibody
from aerotact.laws.suarez2020 import bimanual, cartesian_motion, compliant_joint, contact_force
from aerotact.laws.suarez2020.arm_feedback import Heard, InstrumentedArm, instrumented_arms
from aerotact.plant.clamp import Clamp
from aerotact.plant.disturbance import ToolForce
from aerotact.plant.plant import Plant
from aerotact.ports import Array
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
JOINTS = (0, 3)
UP = np.array([0.0, 0.0, 9.81])
RESOLUTION = 0.005672  # rad, of servo feedback


@pytest.fixture(scope="module")
def standard() -> Multibody:
    return Multibody(load_robot(MODELS / "dual_arm_standard"))


@pytest.fixture(scope="module")
def left(standard: Multibody) -> ArmKinematics:
    return arm_kinematics(standard.robot, "left")


@pytest.fixture(scope="module")
def arms(standard: Multibody) -> tuple[InstrumentedArm, ...]:
    return instrumented_arms(standard)


def _column(value: ca.DM) -> Array:
    return np.asarray(ca.DM(value).full().ravel())


def _holding(kin: ArmKinematics, q: Array, force: Array) -> Array:
    """Servo angles under which the links stand at q with a force on the environment, by virtual work."""
    torque = _column(kin.gravity_torque(ca.DM(q), ca.DM(UP))) + kin.jacobian(ca.DM(q)).full().T @ force
    return q + torque / kin.stiffness


# Force from deflection


@pytest.fixture(scope="module")
def pressed(standard: Multibody) -> tuple[Array, Array]:
    """Links and shafts of the left arm, L-shaped on a bench, while something holds its tool down with 2 N."""
    plant = Plant(standard.robot, disturbances=[Clamp(), ToolForce((0.0, 0.0, -2.0), 0.0, 10.0)])
    for _ in range(6000):
        plant.step()
    truth = plant.truth()
    assert np.abs(truth["joint_rate"]).max() < 1e-4
    return truth["joint"][:4], truth["servo"][:4]


def test_force_from_deflection_is_what_mujoco_puts_on_the_tool(
    left: ArmKinematics, pressed: tuple[Array, Array]
) -> None:
    q, theta = pressed
    force = contact_force.force_of_deflection(left, ca.DM(theta), ca.DM(q), ca.DM(UP), JOINTS)
    np.testing.assert_allclose(_column(force), [0.0, 0.0, 2.0], atol=0.02)


def test_26_and_27_as_printed_miss_gravity_and_the_way_of_the_jacobian(
    left: ArmKinematics, pressed: tuple[Array, Array]
) -> None:
    q, theta = pressed
    loaded = q.copy()
    loaded[list(JOINTS)] += (_column(left.gravity_torque(ca.DM(q), ca.DM(UP))) / left.stiffness)[list(JOINTS)]
    J = left.jacobian(ca.DM(q)).full()[np.ix_((0, 2), JOINTS)]
    K_C = np.linalg.inv(J).T @ np.diag(left.stiffness[list(JOINTS)]) @ np.linalg.inv(J)
    printed = K_C @ _column(contact_force.cartesian_deflection(left, ca.DM(theta), ca.DM(q)))[[0, 2]]
    at_links = K_C @ _column(contact_force.cartesian_deflection(left, ca.DM(theta), ca.DM(loaded)))[[0, 2]]
    assert printed[1] - 2.0 > 0.3  # gravity is taken for a push
    assert np.linalg.norm(at_links - [0.0, 2.0]) > 0.1  # J^-1 at the links instead of midway


@pytest.mark.parametrize("seed", range(5))
def test_estimate_inverts_virtual_work(left: ArmKinematics, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = np.array([rng.uniform(-0.6, 0.6), 0.0, 0.0, rng.uniform(-2.0, -0.9)])
    force = np.array([rng.normal(), 0.0, rng.normal()])
    theta = _holding(left, q, force)
    told = contact_force.force_of_deflection(left, ca.DM(theta), ca.DM(q), ca.DM(UP), JOINTS)
    np.testing.assert_allclose(_column(told), force, atol=0.03 * np.linalg.norm(force) + 0.01)
    deflections = _column(contact_force.pushing_angles(left, ca.DM(q), ca.DM(force)))
    np.testing.assert_allclose(theta - deflections, _holding(left, q, np.zeros(3)), atol=1e-12)


def test_force_along_makes_up_for_what_the_joints_do_not_feel(left: ArmKinematics) -> None:
    q = left.joints_at([0.2, 0.1, -0.3], 0.4)
    n = np.array([0.0, 1.0, 0.0])
    theta = _holding(left, q, 1.5 * n)
    force = contact_force.force_of_deflection(left, ca.DM(theta), ca.DM(q), ca.DM(UP), JOINTS)
    assert np.linalg.norm(_column(force)) < 1.3
    size = contact_force.force_along(left, ca.DM(q), force, ca.DM(n), JOINTS)
    assert float(size) == pytest.approx(1.5, rel=0.1)


def test_estimate_is_finite_where_the_arm_is_straight(left: ArmKinematics) -> None:
    force = contact_force.force_of_deflection(left, ca.DM.zeros(4), ca.DM.zeros(4), ca.DM(UP), JOINTS)
    assert np.isfinite(_column(force)).all()


def test_compliance_is_the_inverse_of_the_cartesian_stiffness(left: ArmKinematics) -> None:
    q = left.joints_at([0.2, 0.1, -0.3], 0.4)
    C = contact_force.compliance(left, ca.DM(q)).full()
    np.testing.assert_allclose(C @ left.cartesian_stiffness(ca.DM(q)).full(), np.eye(3), atol=1e-9)
    straight = contact_force.compliance(left, ca.DM.zeros(4)).full()
    assert np.linalg.matrix_rank(straight, 1e-9) == 2  # infinitely stiff along the arm, and still a number


def test_links_without_encoders_follow_from_what_they_carry(arms: tuple[InstrumentedArm, ...]) -> None:
    for arm in arms:
        kin = arm.kinematics
        q = kin.joints_at([0.05, 0.0, -0.37], 0.6)
        force = np.array([0.0, 1.9 * kin.side, 0.0])
        theta, servo = _holding(kin, q, force), np.zeros(8)
        servo[list(arm.servos)] = theta
        heard = Heard(ca.DM.zeros(3), ca.DM([1, 0, 0, 0]), ca.DM(servo), ca.DM((theta - q)[list(JOINTS)]), 0.0)
        told = arm.feedback(heard, arm.frame(heard, 9.81), 0.0, ca.DM(force), ca.DM.zeros(3))
        assert np.abs(theta - q).max() > 0.3
        np.testing.assert_allclose(_column(told.r), _column(kin.forward(ca.DM(q))), atol=0.01)


# Joints


def test_22_takes_the_correction_that_is_chosen() -> None:
    theta, position, torque = ca.DM([0.1, 0.2]), ca.DM([0.01, 0.02]), ca.DM([-0.03, -0.04])
    chosen = compliant_joint.servo_reference(theta, position, torque, ca.DM([1.0, 0.0]))
    np.testing.assert_allclose(_column(chosen), [0.11, 0.16])


def test_16_is_the_stiffness_of_springs_at_a_lever() -> None:
    angle, spring, lever = ca.SX.sym("angle"), 900.0, 0.05
    energy = 0.5 * spring * (lever * ca.sin(angle)) ** 2
    stiffness = ca.Function("k", [angle], [ca.hessian(energy, angle)[0]])(0.0)
    assert float(stiffness) == pytest.approx(compliant_joint.lever_stiffness(spring, lever))


# Motion


def _walk(start: Array, goal: Array, speed: float, seconds: float, resolution: float, from_measured: bool) -> Array:
    """A tool on a servo of one metre's arm in each axis: lag of 50 ms, feedback in steps, commands at 50 Hz."""
    actual, wanted = start.copy(), start.copy()
    for _ in range(round(seconds * 50)):
        heard = resolution * np.round(actual / resolution)
        wanted = _column(cartesian_motion.towards(ca.DM(heard if from_measured else wanted), ca.DM(goal), speed, 0.02))
        actual = wanted + np.exp(-0.02 / 0.05) * (actual - wanted)
    return actual


def test_23_as_printed_stands_still_at_the_servos_resolution_and_ours_arrives() -> None:
    start, goal = np.zeros(3), np.array([0.1, 0.0, 0.0])
    printed = _walk(start, goal, 0.02, 8.0, RESOLUTION, from_measured=True)
    ours = _walk(start, goal, 0.02, 8.0, RESOLUTION, from_measured=False)
    assert np.linalg.norm(printed - goal) > 0.05
    np.testing.assert_allclose(ours, goal, atol=1e-3)


def test_23_as_printed_has_no_answer_at_the_goal_and_overshoots_before_it() -> None:
    r, goal = np.zeros(3), np.array([0.0005, 0.0, 0.0])
    with np.errstate(invalid="ignore"):
        assert np.isnan(r + 0.003 * (r - r) / np.linalg.norm(r - r)).all()
    assert (r + 0.003 * (goal - r) / np.linalg.norm(goal - r))[0] > 5 * goal[0]
    np.testing.assert_allclose(_column(cartesian_motion.towards(ca.DM(r), ca.DM(goal), 0.15, 0.02)), goal, atol=1e-12)
    np.testing.assert_allclose(_column(cartesian_motion.towards(ca.DM(goal), ca.DM(goal), 0.15, 0.02)), goal)


def test_24_moves_at_the_joystick_times_the_highest_speed() -> None:
    moved = cartesian_motion.operated(ca.DM.zeros(3), ca.DM([0.5, -3.0, 0.0]), 0.1, 0.02)
    np.testing.assert_allclose(_column(moved), [0.001, -0.002, 0.0])


def test_goals_are_held_within_reach(left: ArmKinematics) -> None:
    far = _column(cartesian_motion.within_reach(left, ca.DM([0.9, 0.0, -0.9])))
    near = _column(cartesian_motion.within_reach(left, ca.DM([0.0, 0.0, -0.01])))
    assert np.linalg.norm(far) == pytest.approx(0.985 * 0.5)
    assert np.linalg.norm(near) == pytest.approx(0.25 * 0.5)


@pytest.mark.parametrize("load", [0.0, 0.2])
def test_holding_angles_hold_the_links_in_mujoco(standard: Multibody, left: ArmKinematics, load: float) -> None:
    q = left.joints_at([0.3, 0.05, -0.2], 0.2)
    plant = Plant(standard.robot, disturbances=[Clamp()])
    plant.disturb(ToolForce((0.0, 0.0, -9.81 * load), 0.0, 60.0) if load else Clamp())
    theta = _column(cartesian_motion.holding_angles(left, ca.DM(q), ca.DM(UP), load))
    for _ in range(6000):
        plant.command(standard.robot.hover_thrust, servo=np.concatenate([theta, standard.hover_servo[4:]]))
        plant.step()
    np.testing.assert_allclose(plant.truth()["joint"][:4], q, atol=2e-4)


# Two arms


def test_bar_goals_invert_29_and_30() -> None:
    centre, axis = np.array([0.3, 0.1, -0.2]), np.array([0.1, 0.98, 0.17])
    axis /= np.linalg.norm(axis)
    r_1, r_2 = bimanual.bar_goals(ca.DM(centre), ca.DM(axis), 0.3)
    found = bimanual.bar_pose(r_1, r_2)
    np.testing.assert_allclose(_column(found[0]), centre, atol=1e-12)
    np.testing.assert_allclose(_column(found[1]), axis, atol=1e-9)


def test_32_presses_what_is_between_the_tools() -> None:
    r_1, r_2 = np.array([0.3, 0.1, -0.2]), np.array([0.25, -0.12, -0.2])
    f_1, f_2 = (_column(f) for f in bimanual.lateral_forces(3.0, ca.DM(r_1), ca.DM(r_2)))
    np.testing.assert_allclose(f_1, -f_2)
    assert np.linalg.norm(f_1) == pytest.approx(3.0, rel=1e-5)
    assert f_1 @ (r_2 - r_1) > 0  # the left one pushes towards the right one
    np.testing.assert_allclose(np.cross(f_1, r_1 - r_2), 0.0, atol=1e-9)


def test_32_has_an_answer_where_the_tools_meet() -> None:
    assert np.isfinite(_column(bimanual.lateral_forces(3.0, ca.DM.zeros(3), ca.DM.zeros(3))[0])).all()


def test_31_as_printed_forgets_where_the_tool_is() -> None:
    r, by_force, by_position = np.array([0.3, 0.0, -0.2]), np.array([0.0, 0.0, 0.01]), np.array([0.02, 0.0, 0.0])
    ours = _column(bimanual.blended(ca.DM(r), 0.25, ca.DM(by_force), ca.DM(by_position)))
    np.testing.assert_allclose(ours - r, 0.25 * by_force + 0.75 * by_position)
    printed = 0.25 * by_force + 0.75 * by_position
    assert np.linalg.norm(printed) < 0.05  # as a position it lies in the shoulder


def test_33_tells_by_distance() -> None:
    assert not float(bimanual.disconnected(ca.DM([0, 0, 0]), ca.DM([0.004, 0, 0]), 0.005))
    assert float(bimanual.disconnected(ca.DM([0, 0, 0]), ca.DM([0.004, 0.004, 0]), 0.005))


@pytest.mark.parametrize("name", ["dual_arm_standard", "dual_arm_long_reach"])
def test_an_arm_that_holds_a_point_tells_where_the_base_is(name: str) -> None:
    robot = load_robot(MODELS / name)
    kin, data, rng = arm_kinematics(robot, "left"), mujoco.MjData(robot.mjmodel), np.random.default_rng(1)
    passive = len(robot.passive)
    for _ in range(5):
        turn = Rotation.from_rotvec(0.3 * rng.normal(size=3)).as_quat(scalar_first=True)
        data.qpos[:3], data.qpos[3:7] = rng.normal(size=3), turn
        data.qpos[7:] = rng.uniform(-0.5, 0.5, robot.mjmodel.nq - 7)
        mujoco.mj_kinematics(robot.mjmodel, data)
        q, swing = data.qpos[7 + passive : 11 + passive], float(data.qpos[7]) if passive else 0.0
        point = data.site("arm_left_tip").xpos
        found = bimanual.base_from_tool(kin, ca.DM(turn), swing, ca.DM(q), ca.DM(point))
        np.testing.assert_allclose(_column(found), data.qpos[:3], atol=1e-12)
