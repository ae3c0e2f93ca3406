"""The robot folder: what load_robot derives agrees with MuJoCo, and every spoilt folder is refused by name."""

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.exceptions import AerotactError, RobotError, UnknownName
from aerotact.resources import robot_folders
from aerotact.robot import Robot, load_robot

OCTOROTOR = Path(__file__).parent / "fixtures" / "octorotor"


@pytest.fixture(scope="module", params=["tilt_hex", "tilt_rotor", str(OCTOROTOR)], ids=lambda p: Path(p).name)
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


def _at_hover(robot: Robot) -> mujoco.MjData:
    data = mujoco.MjData(robot.mjmodel)
    key = mujoco.mj_name2id(robot.mjmodel, mujoco.mjtObj.mjOBJ_KEY, "hover")
    mujoco.mj_resetDataKeyframe(robot.mjmodel, data, key)
    mujoco.mj_forward(robot.mjmodel, data)
    return data


def test_hover_keyframe_is_an_exact_trim(robot: Robot) -> None:
    data = _at_hover(robot)
    assert data.qacc.size >= 6
    assert np.abs(data.qacc).max() < 1e-12
    assert np.abs(data.act_dot).max() < 1e-12
    np.testing.assert_array_equal(data.act, data.ctrl)
    for rotor, thrust in zip(robot.rotors, robot.hover_thrust, strict=True):
        assert rotor.thrust[0] < thrust < rotor.thrust[1]


def test_mass_and_centre_of_mass_equal_mujoco(robot: Robot) -> None:
    data = _at_hover(robot)
    assert robot.mass == pytest.approx(robot.mjmodel.body_subtreemass[robot.base_id], rel=1e-14)
    R_WB = data.xmat[robot.base_id].reshape(3, 3)
    p_BC = R_WB.T @ (data.subtree_com[robot.base_id] - data.xpos[robot.base_id])
    np.testing.assert_allclose(robot.p_BC, p_BC, atol=1e-14)


def test_inertia_equals_mass_matrix(robot: Robot) -> None:
    data = _at_hover(robot)
    full = np.zeros((robot.mjmodel.nv, robot.mjmodel.nv))
    mujoco.mj_fullM(robot.mjmodel, data, full)
    full = full[:6, :6]
    c = robot.p_BC
    skew = np.array([[0, -c[2], c[1]], [c[2], 0, -c[0]], [-c[1], c[0], 0]])
    expected = np.block(
        [
            [robot.mass * np.eye(3), -robot.mass * skew],
            [robot.mass * skew, robot.J_C - robot.mass * skew @ skew],
        ]
    )
    np.testing.assert_allclose(full, expected, atol=1e-13)


def test_allocation_equals_mujoco(robot: Robot) -> None:
    data = _at_hover(robot)
    for rotor in robot.rotors:
        data.act[:] = 0.0
        data.act[robot.mjmodel.actuator_actadr[rotor.index]] = 1.0
        mujoco.mj_forward(robot.mjmodel, data)
        torque_B = np.cross(rotor.p_BR, rotor.axis_B) + rotor.drag * rotor.axis_B
        np.testing.assert_allclose(data.qfrc_actuator[:6], [*rotor.axis_B, *torque_B], atol=1e-14)


def test_tilt_hex_has_the_papers_geometry() -> None:
    """ryll2019 (4), (5) with 30 and 10 degrees, hub radius 0.4 m."""
    robot = load_robot("tilt_hex")
    assert robot.mass == pytest.approx(1.8, rel=1e-15)
    np.testing.assert_array_equal(robot.p_BC, 0.0)
    np.testing.assert_allclose(robot.p_BE, [0.12, 0.0, -0.4], atol=1e-15)
    np.testing.assert_allclose(robot.R_BE, np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    alpha, beta = np.deg2rad([30.0, 10.0])
    assert len(robot.rotors) == 6
    for i, rotor in enumerate(robot.rotors):
        c, s = np.cos(i * np.pi / 3), np.sin(i * np.pi / 3)
        Rz = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        sign = (-1) ** i
        axis = [np.sin(beta), -sign * np.sin(alpha) * np.cos(beta), np.cos(alpha) * np.cos(beta)]
        np.testing.assert_allclose(rotor.axis_B, Rz @ axis, atol=1e-14)
        np.testing.assert_allclose(rotor.p_BR, Rz @ [0.4, 0.0, 0.0], atol=1e-14)
        assert rotor.drag == sign * 0.0192
        assert rotor.thrust == (0.25, 11.98)
    expected = robot.mass * robot.gravity / (6 * np.cos(alpha) * np.cos(beta))
    np.testing.assert_allclose(robot.hover_thrust, expected, rtol=1e-14)


def test_tilt_rotor_has_the_papers_geometry() -> None:
    """bodie2021 Table II, and the values that the robot's README gives."""
    robot = load_robot("tilt_rotor")
    assert robot.mass == pytest.approx(5.0, rel=1e-14)
    np.testing.assert_allclose(robot.J_C, np.diag([0.12, 0.14, 0.18]), atol=1e-12)
    np.testing.assert_array_equal(robot.p_BC, 0.0)
    np.testing.assert_allclose(robot.p_BE, [0.55, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(robot.R_BE[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
    for i, rotor in enumerate(robot.rotors):
        angle = np.pi / 6 + i * np.pi / 3
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        assert rotor.thrust == (0.2, 20.0)
        assert rotor.tilt is not None
        np.testing.assert_allclose(rotor.p_BR, 0.3 * outward, atol=1e-14)
        np.testing.assert_allclose(rotor.tilt.p_BH, 0.3 * outward, atol=1e-14)
        np.testing.assert_allclose(rotor.tilt.axis_B, outward, atol=1e-14)
        np.testing.assert_allclose(rotor.axis_B, [0.0, 0.0, 1.0], atol=1e-14)
        assert rotor.tilt.rate == (-5.97, 5.97)
        assert rotor.tilt.time_constant == 0.048
    np.testing.assert_allclose(robot.hover_thrust, 5.0 * 9.81 / 6, rtol=1e-14)
    np.testing.assert_array_equal(robot.hover_tilt, np.zeros(6))
    sensor = robot.force_torque
    assert sensor is not None
    np.testing.assert_allclose(sensor.p_BS, [0.49, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(sensor.R_BS, robot.R_BE, atol=1e-15)
    np.testing.assert_allclose(sensor.p_SD, [0.0, 0.0, 0.04], atol=1e-15)
    assert sensor.distal_mass == 0.03


def test_hinges_equal_mujoco() -> None:
    """Turned by MuJoCo, the rotors stand where anchor and axis say."""
    robot = load_robot("tilt_rotor")
    data = mujoco.MjData(robot.mjmodel)
    angles = np.linspace(-2.0, 3.0, 6)
    data.qpos[:] = robot.mjmodel.qpos0
    data.qpos[7:] = angles
    mujoco.mj_kinematics(robot.mjmodel, data)
    for rotor, angle in zip(robot.rotors, angles, strict=True):
        assert rotor.tilt is not None
        site = robot.mjmodel.actuator_trnid[rotor.index, 0]
        turn = Rotation.from_rotvec(angle * rotor.tilt.axis_B)
        place = rotor.tilt.p_BH + turn.apply(rotor.p_BR - rotor.tilt.p_BH)
        np.testing.assert_allclose(data.site_xpos[site] - data.xpos[robot.base_id], place, atol=1e-14)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3)[:, 2], turn.apply(rotor.axis_B), atol=1e-14)


def test_octorotor_is_unlike_the_first_robot() -> None:
    robot = load_robot(OCTOROTOR)
    assert len(robot.rotors) == 8
    assert np.linalg.norm(robot.p_BC) > 5e-3
    assert np.linalg.norm(robot.p_BI) > 5e-3
    np.testing.assert_allclose(robot.R_BE[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
    A = np.array([[*r.axis_B, *(np.cross(r.p_BR, r.axis_B) + r.drag * r.axis_B)] for r in robot.rotors]).T
    assert np.linalg.matrix_rank(A) == 6
    np.testing.assert_allclose(A @ robot.hover_thrust, _weight(robot), atol=1e-12)


def _weight(robot: Robot) -> np.ndarray:
    force = np.array([0.0, 0.0, robot.mass * robot.gravity])
    return np.concatenate([force, np.cross(robot.p_BC, force)])


def test_names_are_found() -> None:
    assert "tilt_hex" in robot_folders()
    with pytest.raises(UnknownName, match=r"no_such_robot.*tilt_hex"):
        load_robot("no_such_robot")


SPOILT = {
    # name: (file, old text, new text, part of the message that must be named)
    "unknown actuator": ("robot.toml", 'actuator = "lift3"', 'actuator = "lift33"', "rotors[2].actuator"),
    "unknown base": ("robot.toml", 'base = "frame"', 'base = "fram"', "robot.base"),
    "unknown tool": ("robot.toml", 'tool = "lance_end"', 'tool = "lance"', "robot.tool"),
    "unknown imu": ("robot.toml", 'imu = "autopilot"', 'imu = "pilot"', "robot.imu"),
    "missing key": ("robot.toml", "rate = 500.0", "", "sensors.imu.rate"),
    "missing base": ("robot.toml", 'base = "frame"', "", "robot.base"),
    "unknown key": ("robot.toml", 'base = "frame"', 'base = "frame"\nbses = "x"', "robot.bses"),
    "missing source": (
        "robot.toml",
        'position_noise = { value = 0.0005, unit = "m", source = "assumed" }',
        'position_noise = { value = 0.0005, unit = "m" }',
        "sensors.motion_capture.position_noise.source",
    ),
    "rate not positive": ("robot.toml", "rate = 100.0", "rate = 0.0", "sensors.motion_capture.rate"),
    "thrust rate of wrong sign": ("robot.toml", "[-60.0, 60.0]", "[60.0, -60.0]", "rotors[0].thrust_rate"),
    "thrust rate of one number": ("robot.toml", "[-60.0, 60.0]", "60.0", "rotors[0].thrust_rate"),
    "thrust rate of wrong unit": ("robot.toml", '"N/s"', '"N"', "rotors[0].thrust_rate"),
    "broken toml": ("robot.toml", "[robot]", "[robot", "file"),
    "negative mass": ("plant.xml", 'mass="0.95"', 'mass="-0.95"', "model"),
    "broken xml": ("plant.xml", "</worldbody>", "</worldbod>", "model"),
    "no hover": ("plant.xml", 'key name="hover"', 'key name="start"', "hover keyframe"),
    "no range": ("plant.xml", ' ctrlrange="0.4 12"', "", "actuator 'lift1'"),
    "no lag": (
        "plant.xml",
        'dyntype="filterexact" dynprm="0.03"',
        'dyntype="filterexact" dynprm="0"',
        "actuator 'lift1'",
    ),
    "bad gear": ("plant.xml", 'gear="0 0 1 0 0 0.014"', 'gear="1 0 0 0 0 0.014"', "actuator 'lift1'"),
    "rotor listed twice": ("robot.toml", 'actuator = "lift3"', 'actuator = "lift2"', "rotors[2].actuator"),
    "gain of two": ("plant.xml", 'ctrlrange="0.4 12"', 'ctrlrange="0.4 12" gainprm="2"', "actuator 'lift1'"),
    "hover without activation": ("plant.xml", 'act="4.', 'act="3.', "hover keyframe"),
    "no free joint": ("plant.xml", "<freejoint/>", '<joint type="hinge" name="h"/>', None),
}


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt_folder_is_refused(case: str, tmp_path: Path) -> None:
    file, old, new, part = SPOILT[case]
    folder = tmp_path / "spoilt"
    shutil.copytree(OCTOROTOR, folder)
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    with pytest.raises(RobotError) as caught:
        load_robot(folder)
    assert str(folder) in str(caught.value)
    assert caught.value.remedy
    if part is not None:
        assert caught.value.part == part
        assert Path(caught.value.file).name in ("plant.xml", "robot.toml")


SPOILT_TILT = {
    "no such hinge": ("robot.toml", 'tilt = "tilt3"', 'tilt = "tilt33"', "rotors.tilt"),
    "hinge of another rotor": ("robot.toml", 'tilt = "tilt3"', 'tilt = "tilt2"', "joint 'tilt2'"),
    "free joint": ("robot.toml", 'tilt = "tilt3"', 'tilt = "base_free"', "joint 'base_free'"),
    "no rate": ("robot.toml", "tilt_rate = { value = 5.97", "# tilt_rate = { value = 5.97", "rotors[0].tilt_rate"),
    "rate of a fixed rotor": ("robot.toml", 'tilt = "tilt1"', "", "rotors[0].tilt_rate"),
    "rate in degrees": ("robot.toml", 'unit = "rad/s", source = "data', 'unit = "deg/s", source = "data', None),
    "rate below zero": ("robot.toml", "value = 5.97", "value = -5.97", "rotors[0].tilt_rate"),
    "no servo": ("plant.xml", 'name="servo2" joint="tilt2"', 'name="servo2" site="rotor2"', "joint 'tilt2'"),
    "two servos": ("plant.xml", 'name="servo2" joint="tilt2"', 'name="servo2" joint="tilt1"', "joint 'tilt1'"),
    "servo without range": ("plant.xml", 'ctrlrange="-6.283185307179586 6.283185307179586"', "", "actuator 'servo1'"),
    "servo without lag": ("plant.xml", 'dynprm="0.048"', 'dynprm="0"', "actuator 'servo1'"),
    "servo that is a motor": ("plant.xml", 'biasprm="0 -200 -0.4"', 'biasprm="0 0 -0.4"', "actuator 'servo1'"),
    "slide": ("plant.xml", '<joint type="hinge"', '<joint type="slide"', "joint 'tilt1'"),
    "hover off the servo": ("plant.xml", 'qpos="0 0 1.5 1 0 0 0 0', 'qpos="0 0 1.5 1 0 0 0 0.1', "hover keyframe"),
    "no such sensor site": ("robot.toml", 'site = "force_torque"', 'site = "force"', "sensors.force_torque.site"),
    "sensor on the base": ("robot.toml", 'site = "force_torque"', 'site = "imu"', "site 'imu'"),
    "sensor on a hinge": ("robot.toml", 'site = "force_torque"', 'site = "rotor1"', "site 'rotor1'"),
}


@pytest.mark.parametrize("case", SPOILT_TILT)
def test_spoilt_tilt_is_refused(case: str, tmp_path: Path) -> None:
    file, old, new, part = SPOILT_TILT[case]
    folder = tmp_path / "spoilt"
    shutil.copytree(load_robot("tilt_rotor").folder, folder)
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    with pytest.raises(RobotError) as caught:
        load_robot(folder)
    assert str(folder) in str(caught.value)
    assert caught.value.remedy
    if part is not None:
        assert caught.value.part == part


@pytest.mark.parametrize("file", ["plant.xml", "robot.toml"])
def test_missing_file_is_refused(file: str, tmp_path: Path) -> None:
    folder = tmp_path / "spoilt"
    shutil.copytree(OCTOROTOR, folder)
    (folder / file).unlink()
    with pytest.raises(RobotError, match=rf"{file}: file: does not exist"):
        load_robot(folder)


def test_errors_share_one_base() -> None:
    assert issubclass(RobotError, AerotactError)
    assert issubclass(UnknownName, AerotactError)
