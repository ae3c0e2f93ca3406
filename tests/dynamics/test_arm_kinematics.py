"""Arm kinematics of suarez2020 beside MuJoCo: forward, Jacobian, inverse with imposed roll, statics, frames."""

import shutil
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest

from aerotact.dynamics.arm_kinematics import ArmKinematics, Elbow, arm_kinematics
from aerotact.exceptions import InputError, RobotError, UnknownName
from aerotact.robot import Robot, load_robot

MODELS = Path(__file__).parents[2] / "models"
ROBOTS = ("dual_arm_standard", "dual_arm_long_reach")
CASES = [(robot, arm) for robot in ROBOTS for arm in ("left", "right")]
STEP = 1e-6


@pytest.fixture(scope="module", params=CASES, ids=lambda c: f"{c[0]}-{c[1]}")
def arm(request: pytest.FixtureRequest) -> tuple[Robot, ArmKinematics]:
    name, side = request.param
    robot = load_robot(MODELS / name)
    return robot, arm_kinematics(robot, side)


def _function(kinematics: ArmKinematics, method: str) -> ca.Function:
    q = ca.SX.sym("q", 4)
    return ca.Function(method, [q], [getattr(kinematics, method)(q)])


def _joints(robot: Robot, name: str) -> list[int]:
    return [j.index for a in robot.arms if a.name == name for j in a.joints]


def _random_joints(robot: Robot, name: str, rng: np.random.Generator) -> np.ndarray:
    lower, upper = robot.mjmodel.jnt_range[_joints(robot, name)].T
    return rng.uniform(lower, upper)


def _posed(robot: Robot, kinematics: ArmKinematics, q: np.ndarray, swing: float) -> mujoco.MjData:
    model = robot.mjmodel
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[_joints(robot, kinematics.name)]] = q
    data.qpos[model.jnt_qposadr[[j.index for j in robot.passive]]] = swing
    data.qpos[:7] = [0.3, -0.2, 1.9, *np.array([0.9, 0.1, -0.3, 0.2]) / np.linalg.norm([0.9, 0.1, -0.3, 0.2])]
    mujoco.mj_forward(model, data)
    return data


def test_geometry_is_the_papers(arm: tuple[Robot, ArmKinematics]) -> None:
    robot, kinematics = arm
    assert (kinematics.upper, kinematics.lower) == pytest.approx((0.25, 0.25), abs=1e-15)
    assert kinematics.side == (1.0 if kinematics.name == "left" else -1.0)
    np.testing.assert_array_equal(kinematics.stiffness, [2.93, 2.1, 0.8, 1.48])
    p_BS, R_BS = kinematics.shoulder_pose(0.0)
    height = -0.8 if robot.passive else -0.2
    np.testing.assert_allclose(p_BS.full().ravel(), [0.0, 0.15 * kinematics.side, height], atol=1e-15)
    np.testing.assert_array_equal(R_BS.full(), np.eye(3))


def test_forward_and_frames_equal_mujoco(arm: tuple[Robot, ArmKinematics]) -> None:
    robot, kinematics = arm
    rng, forward = np.random.default_rng(1), _function(kinematics, "forward")
    site = next(a.tool_index for a in robot.arms if a.name == kinematics.name)
    for _ in range(50):
        q, swing = _random_joints(robot, kinematics.name, rng), rng.uniform(-1, 1) if robot.passive else 0.0
        data = _posed(robot, kinematics, q, swing)
        pose = ca.DM(data.qpos[:3]), ca.DM(data.qpos[3:7])
        found = kinematics.from_shoulder(*pose, swing, forward(q))
        np.testing.assert_allclose(found.full().ravel(), data.site_xpos[site], atol=1e-14)
        back = kinematics.to_shoulder(*pose, swing, ca.DM(data.site_xpos[site]))
        np.testing.assert_allclose(back.full(), forward(q).full(), atol=1e-14)


def test_transpose_of_4_as_printed_is_not_the_way_back(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    p_BS, R_BS = kinematics.shoulder_pose(0.4)
    transform = np.vstack([np.hstack([R_BS.full(), p_BS.full()]), [0, 0, 0, 1]])
    point = np.array([0.2, 0.1, -0.4, 1.0])
    assert np.abs(transform.T @ (transform @ point) - point).max() > 0.05
    rest = ca.DM([0, 0, 0]), ca.DM([1, 0, 0, 0])
    mended = kinematics.to_shoulder(*rest, 0.4, ca.DM((transform @ point)[:3]))
    np.testing.assert_allclose(mended.full().ravel(), point[:3], atol=1e-15)


def test_jacobian_by_finite_differences(arm: tuple[Robot, ArmKinematics]) -> None:
    robot, kinematics = arm
    rng, forward, jacobian = np.random.default_rng(2), *(_function(kinematics, m) for m in ("forward", "jacobian"))
    for _ in range(20):
        q = _random_joints(robot, kinematics.name, rng)
        columns = [(forward(q + STEP * e) - forward(q - STEP * e)).full().ravel() / (2 * STEP) for e in np.eye(4)]
        np.testing.assert_allclose(jacobian(q).full(), np.array(columns).T, atol=1e-9)


@pytest.mark.parametrize("elbow", [-1, 1])
def test_inverse_is_exact_over_thousands_of_poses(arm: tuple[Robot, ArmKinematics], elbow: Elbow) -> None:
    robot, kinematics = arm
    r, roll = ca.SX.sym("r", 3), ca.SX.sym("roll")
    inverse = ca.Function("inverse", [r, roll], [kinematics.inverse(r, roll, elbow), kinematics.margins(r, roll)])
    forward, rng, count = _function(kinematics, "forward"), np.random.default_rng(3), 3000
    q = np.array([_random_joints(robot, kinematics.name, rng) for _ in range(count)])
    q[:, 3] = elbow * np.abs(q[:, 3])
    goals = forward.map(count)(q.T).full()
    found, margins = (v.full() for v in inverse.map(count)(goals, q[None, :, 1]))
    assert margins.min() > -1e-15
    assert np.abs(forward.map(count)(found).full() - goals).max() < 1e-10
    np.testing.assert_array_equal(found[1], q[:, 1])
    regular = (np.abs(q[:, 3]) > 0.3) & (np.abs(q[:, 2]) < 1.2) & (np.abs(q[:, 1]) < 1.2)
    assert regular.sum() > 1000
    turned = np.abs((found - q.T)[:, regular] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(turned).max() < 1e-9


def test_inverse_of_the_l_pose(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    np.testing.assert_allclose(kinematics.joints_at([0.25, 0, -0.25], 0.0), [0, 0, 0, -np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(kinematics.joints_at([0.0, 0, -0.5], 0.0)[[0, 3]], 0.0, atol=1e-7)


@pytest.mark.parametrize(
    ("r", "roll", "said"),
    [
        ([0.4, 0.0, -0.4], 0.0, r"0\.5657 m from the shoulder; valid: a reach of 0 to 0\.5 m"),
        ([0.1, 0.4, -0.1], 0.0, r"out of reach with a shoulder roll of 0 rad; valid: y of -0\.\d+ to 0\.\d+ m"),
        ([0.2, np.nan, -0.1], 0.0, r"valid: finite"),
    ],
)
def test_out_of_reach_is_said(arm: tuple[Robot, ArmKinematics], r: list[float], roll: float, said: str) -> None:
    _, kinematics = arm
    with pytest.raises(InputError, match=said):
        kinematics.joints_at(r, roll)


def test_sideways_reach_is_where_it_ends(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    distance, roll = 0.4, 0.3
    for limit, sign in zip(kinematics._sideways(distance, roll), (-1, 1), strict=True):
        for inside in (True, False):
            y = limit - sign * (1e-4 if inside else -1e-4)
            goal = [0.1, y, -np.sqrt(distance**2 - y**2 - 0.01)]
            if inside:
                q = kinematics.joints_at(goal, roll)
                np.testing.assert_allclose(kinematics.forward(ca.DM(q)).full().ravel(), goal, atol=1e-12)
            else:
                with pytest.raises(InputError, match="out of reach"):
                    kinematics.joints_at(goal, roll)


def test_beyond_reach_the_expression_stays_finite(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    for goal in ([9.0, 0, 0], [0, 9.0, 0], [0, 0, 0]):
        assert np.isfinite(kinematics.inverse(ca.DM(goal), 0.2).full()).all()


def test_gravity_torque_equals_mujoco(arm: tuple[Robot, ArmKinematics]) -> None:
    robot, kinematics = arm
    rng, model = np.random.default_rng(4), robot.mjmodel
    for _ in range(30):
        q, swing = _random_joints(robot, kinematics.name, rng), rng.uniform(-1, 1) if robot.passive else 0.0
        data = _posed(robot, kinematics, q, swing)
        _, R_BS = kinematics.shoulder_pose(swing)
        up = R_BS.full().T @ data.xmat[robot.base_id].reshape(3, 3).T @ [0, 0, 9.81]
        found = kinematics.gravity_torque(ca.DM(q), ca.DM(up)).full().ravel()
        expected = data.qfrc_bias[model.jnt_dofadr[_joints(robot, kinematics.name)]]
        np.testing.assert_allclose(found, expected, atol=1e-14)
        assert np.abs(found).max() > 1e-3


def test_cartesian_stiffness_is_force_over_deflection(arm: tuple[Robot, ArmKinematics]) -> None:
    """A small force moves the tool by its stiffness's inverse times itself, whatever the joints have to do for it."""
    _, kinematics = arm
    q, f = np.array([0.2, 0.3, -0.2, -1.4]), 1e-5 * np.array([1.0, -2.0, 1.5])
    J = kinematics.jacobian(ca.DM(q))
    servo = kinematics.servo_for(ca.DM(q), ca.mtimes(J.T, ca.DM(f)))  # q is where the arm pushes f from
    deflection = kinematics.forward(servo) - kinematics.forward(ca.DM(q))
    force = ca.mtimes(kinematics.cartesian_stiffness(ca.DM(q)), deflection).full().ravel()
    np.testing.assert_allclose(force, f, rtol=1e-4)


def test_planar_stiffness_equals_27_of_the_two_instrumented_joints(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    q = ca.DM([0.1, 0.0, 0.0, -1.5])
    J = kinematics.jacobian(q).full()[np.ix_([0, 2], [0, 3])]
    printed = np.linalg.inv(J).T @ np.diag(kinematics.stiffness[[0, 3]]) @ np.linalg.inv(J)
    found = kinematics.cartesian_stiffness(q, (0, 2), (0, 3)).full()
    np.testing.assert_allclose(found, printed, rtol=1e-12)


def test_stiffness_grows_towards_the_singularity(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    bent, straight = (
        np.linalg.eigvalsh(kinematics.cartesian_stiffness(ca.DM([0.0, 0.0, 0.0, bend]), (0, 2), (0, 3)).full())[-1]
        for bend in (-np.pi / 2, -0.1)
    )
    assert straight > 50 * bent


def test_jacobian_inverse_of_27_as_printed_does_not_exist(arm: tuple[Robot, ArmKinematics]) -> None:
    _, kinematics = arm
    J = kinematics.jacobian(ca.DM([0.2, 0.3, -0.2, -1.4])).full()
    assert J.shape == (3, 4)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.inv(J)


def test_unknown_arm() -> None:
    with pytest.raises(UnknownName, match=r"unknown arm 'third' in robot 'dual_arm_standard'; valid: left, right"):
        arm_kinematics(load_robot(MODELS / "dual_arm_standard"), "third")


def test_other_axes_are_refused(tmp_path: Path) -> None:
    for part in ("parts", "dual_arm_standard"):
        shutil.copytree(MODELS / part, tmp_path / part)
    file = tmp_path / "parts" / "dual_arm.xml"
    text = file.read_text()
    assert 'class="shoulder_roll" axis="1 0 0"' in text
    file.write_text(text.replace('class="shoulder_roll" axis="1 0 0"', 'class="shoulder_roll" axis="1 0.2 0"'))
    robot = load_robot(tmp_path / "dual_arm_standard")
    with pytest.raises(RobotError, match=r"arm 'left': is no arm of shoulder pitch, roll, yaw and elbow pitch"):
        arm_kinematics(robot, "left")
    assert arm_kinematics(robot, "right").side == -1.0
