"""Arms in the plant: hover holds, servos lag and are limited, springs carry contact, sensors tell."""

import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import InputError, RobotError
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.robot import Robot, load_robot

MODELS = Path(__file__).parents[2] / "models"
LONG = "dual_arm_long_reach"
STEP = 1e-3


@pytest.fixture(params=["dual_arm_standard", LONG])
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(MODELS / request.param)


def _model(robot: Robot) -> Multibody:
    model = model_of(robot)
    assert isinstance(model, Multibody)
    return model


def test_hover_holds_with_commands_of_hover(robot: Robot) -> None:
    plant, model = Plant(robot, "floor"), _model(robot)
    plant.command(robot.hover_thrust, servo=model.hover_servo)
    before = plant.truth()
    for _ in range(500):
        plant.step()
    after = plant.truth()
    assert after["joint"].shape == (model.joints,)
    assert after["p_tools_W"].shape == (6,)
    for name in ("p_WB", "joint", "servo", "p_tools_W"):
        np.testing.assert_allclose(after[name], before[name], atol=1e-12)


def test_servo_lags_by_17_until_its_speed_limits_it(robot: Robot) -> None:
    plant, model = Plant(robot), _model(robot)
    small, large = model.hover_servo.copy(), model.hover_servo.copy()
    small[0] += 0.1
    large[4] += 0.9
    plant.command(robot.hover_thrust, servo=small)
    for step in range(1, 101):
        plant.step()
        expected = 0.1 * -np.expm1(-step * STEP / 0.05)
        assert plant.joints.shafts()[0] - model.hover_servo[0] == pytest.approx(expected, abs=1e-12)
    plant.reset()
    plant.command(robot.hover_thrust, servo=large)
    angles = []
    for _ in range(60):
        plant.step()
        angles.append(plant.joints.shafts()[4])
    assert np.diff(angles).max() / STEP == pytest.approx(7.1, rel=1e-9)


def test_accelerations_are_the_models_while_servos_turn(robot: Robot) -> None:
    """The plant adds d theta_rate of (15); without it the elbow's acceleration would differ by half."""
    plant, model = Plant(robot, timestep=1e-5), _model(robot)
    command = model.hover_servo.copy()
    command[3] += 0.2
    plant.command(robot.hover_thrust, servo=command)
    plant.step()
    mujoco.mj_forward(plant.model, plant.data)
    rates = model.rates(model.hover_state, np.concatenate([robot.hover_thrust, command])).full().ravel()
    found = model.state.unpack(model.function(model.hover_state, rates, np.zeros(model.disturbance.size)).full())
    elbow = model.passive + 3
    there = plant.data.qacc[6 + elbow]
    assert there == pytest.approx(found["joint_rate"][elbow], rel=5e-3)
    without = model.function(model.hover_state, np.zeros(model.control.size), np.zeros(model.disturbance.size))
    assert abs(model.state.unpack(without.full())["joint_rate"][elbow]) < 1e-9 < 1.0 < abs(there)


def test_deflection_carries_the_contact_on_the_bench() -> None:
    """suarez2020 (14), (15): k (theta - q) is gravity less contact, quasi-statically; the arms alone on a stand."""
    mj = mujoco.MjModel.from_xml_path(str(MODELS / "parts" / "dual_arm.xml"))
    data, site, J = mujoco.MjData(mj), mj.site("left_tip").id, np.zeros((3, mj.nv))
    assert mj.nq == mj.nu == 8
    assert mj.body_mass.sum() == pytest.approx(1.3, rel=1e-14)
    force, elbows = np.array([0.2, 0.0, -1.0]), [mj.actuator(f"{side}_elbow_pitch").id for side in ("left", "right")]
    data.ctrl[elbows] = -1.65
    for _ in range(12000):
        body, none = int(mj.site_bodyid[site]), np.zeros(3)
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(mj, data, force, none, data.site_xpos[site].copy(), body, data.qfrc_applied)
        mujoco.mj_step(mj, data)
    assert np.abs(data.qvel).max() < 1e-6
    mujoco.mj_forward(mj, data)
    mujoco.mj_jacSite(mj, data, J, None, site)
    torque = mj.actuator_gainprm[:, 0] * (data.act - data.qpos)
    contact = torque - data.qfrc_bias
    np.testing.assert_allclose(contact[[0, 3]], (-J.T @ force)[[0, 3]], rtol=1e-4)
    assert np.abs(contact[[0, 3]]).min() > 0.1
    np.testing.assert_allclose(contact[4:], 0.0, atol=1e-6)


def test_commands_are_cut_and_checked(robot: Robot) -> None:
    plant, model = Plant(robot), _model(robot)
    plant.command(robot.hover_thrust, servo=np.full(8, 99.0))
    for _ in range(1500):
        plant.joints.turn()
        plant.data.act[:] = plant.data.ctrl
    np.testing.assert_allclose(plant.joints.shafts(), model.servo_limits[1])
    for wrong in (np.zeros(7), np.full(8, np.nan)):
        with pytest.raises(InputError, match=r"servo is .*valid: 8 finite numbers"):
            plant.command(robot.hover_thrust, servo=wrong)


def test_sensors_of_joints(robot: Robot) -> None:
    plant = Plant(robot)
    sensors, again = (Sensors(plant, robot, 3).joints for _ in range(2))
    assert sensors.rates["servo_measured"] == 50.0
    assert sensors.rates["deflection_measured"] == 200.0
    assert ("passive_measured" in sensors.rates) == bool(robot.passive)
    first = sensors.samples()
    for name, value in again.samples().items():
        np.testing.assert_array_equal(value, first[name])
    step = np.deg2rad(0.325)
    np.testing.assert_allclose(first["servo_measured"], plant.joints.shafts(), atol=0.51 * step)
    ticks = first["servo_measured"] / 0.005672
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-9)
    model = _model(robot)
    true = (plant.joints.shafts() - plant.joints.angles()[model.passive :])[[0, 3]]
    many = np.array([sensors.sample("deflection_measured")["deflection_measured"] for _ in range(2000)])
    np.testing.assert_allclose(many.mean(axis=0) - true, sensors.biases["deflection_measured"], atol=2e-5)
    np.testing.assert_allclose(many.std(axis=0), 1.1e-4, rtol=0.1)


def test_rigid_robot_has_none() -> None:
    robot = load_robot(MODELS / "tilt_hex")
    plant = Plant(robot)
    assert plant.joints.names == ()
    assert Sensors(plant, robot, 0).joints.samples() == {}
    assert "joint" not in plant.truth()
    with pytest.raises(InputError, match="valid: 0 finite numbers"):
        plant.command(robot.hover_thrust, servo=[0.1])


SPOILT = {
    "joint of no arm": (
        'joints = ["arm_left_shoulder_pitch", "arm_left_elbow_pitch"]',
        'joints = ["swing"]',
        "sensors.deflection.joints[0]",
    ),
    "arm joint as passive": (
        'joints = ["swing"]  #',
        'joints = ["arm_left_elbow_pitch"]  #',
        "sensors.passive.joints[0]",
    ),
    "noise in degrees": (
        'noise = { value = 1.1e-4, unit = "rad"',
        'noise = { value = 1.1e-4, unit = "deg"',
        "sensors.deflection.noise",
    ),
    "negative resolution": ("value = 0.005672", "value = -0.005672", "sensors.servo.resolution"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt_sensor_is_refused(case: str, tmp_path: Path) -> None:
    old, new, part = SPOILT[case]
    for folder in ("parts", LONG):
        shutil.copytree(MODELS / folder, tmp_path / folder)
    toml = tmp_path / LONG / "robot.toml"
    assert old in toml.read_text()
    toml.write_text(toml.read_text().replace(old, new, 1))
    robot = load_robot(tmp_path / LONG)
    with pytest.raises(RobotError) as caught:
        Sensors(Plant(robot), robot, 0)
    assert caught.value.part == part
    assert re.search(r"robot\.toml", caught.value.file)


def test_servo_sensor_without_arms_is_refused(tmp_path: Path) -> None:
    shutil.copytree(MODELS / "tilt_hex", tmp_path / "robot")
    toml = tmp_path / "robot" / "robot.toml"
    entry = '[sensors.servo]\nrate = 50.0\nresolution = { value = 0.01, unit = "rad", source = "assumed" }\n'
    toml.write_text(toml.read_text().replace("[sensors.imu]", entry + "[sensors.imu]"))
    robot = load_robot(tmp_path / "robot")
    with pytest.raises(RobotError, match=r"sensors\.servo: there are no arms; leave the sensor out"):
        Sensors(Plant(robot), robot, 0)
