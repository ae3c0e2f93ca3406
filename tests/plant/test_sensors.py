"""Sensors: what they measure without noise, their statistics, their seeds and bad entries of robot.toml."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aerotact.exceptions import RobotError
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.robot import Robot, load_robot

SAMPLES = 20000


def folder_with(robot: Robot, target: Path, *changes: tuple[str, str, str]) -> Path:
    """A copy of a robot's folder with texts replaced: (file, old, new)."""
    for name in ("plant.xml", "robot.toml"):
        text = (robot.folder / name).read_text()
        for file, old, new in changes:
            if file == name:
                assert old in text
                text = text.replace(old, new, 1)
        (target / name).write_text(text)
    return target


def test_imu_noise_and_bias(robot: Robot) -> None:
    """At hover the accelerometer's mean is g along z plus the bias; deviations are those of robot.toml."""
    plant = Plant(robot)
    plant.step()
    sensors = Sensors(plant, robot, seed=5)
    samples = [sensors.imu() for _ in range(SAMPLES)]
    rest = {"accelerometer_B": np.array([0.0, 0.0, robot.gravity]), "gyro_B": np.zeros(3)}
    entries = robot.file.sensors.imu
    noise = {"accelerometer_B": entries.accelerometer_noise, "gyro_B": entries.gyro_noise}
    for name, level in noise.items():
        values = np.array([s[name] for s in samples])
        assert values.shape == (SAMPLES, 3)
        sigma = float(level.array)
        np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.03)
        mean = rest[name] + sensors.biases[name]
        np.testing.assert_allclose(values.mean(axis=0), mean, atol=5 * sigma / np.sqrt(SAMPLES))
        assert (sensors.biases[name] != 0.0).all()


def test_biases_have_the_deviation_of_robot_toml(robot: Robot) -> None:
    plant = Plant(robot)
    biases = np.array([Sensors(plant, robot, seed).biases["gyro_B"] for seed in range(1000)])
    np.testing.assert_allclose(biases.std(axis=0), float(robot.file.sensors.imu.gyro_bias.array), rtol=0.1)


def test_motion_capture_noise(robot: Robot) -> None:
    plant = Plant(robot)
    q_WB = np.array([0.5, -0.5, 0.5, 0.5])
    plant.reset(p_WB=[1.0, -2.0, 3.0], q_WB=q_WB)
    sensors = Sensors(plant, robot, seed=6)
    entry = robot.file.sensors.motion_capture
    samples = [sensors.motion_capture() for _ in range(SAMPLES)]
    p = np.array([s["mocap_p_WB"] for s in samples])
    np.testing.assert_allclose(p.std(axis=0), float(entry.position_noise.array), rtol=0.03)
    np.testing.assert_allclose(p.mean(axis=0), [1.0, -2.0, 3.0], atol=5 * entry.position_noise.array / np.sqrt(SAMPLES))
    q = np.array([s["mocap_q_WB"] for s in samples])
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    angles = np.zeros((SAMPLES, 3))
    for angle, measured in zip(angles, q, strict=True):
        mujoco.mju_subQuat(angle, measured, q_WB)
    np.testing.assert_allclose(angles.std(axis=0), float(entry.attitude_noise.array), rtol=0.03)
    np.testing.assert_allclose(angles.mean(axis=0), 0.0, atol=5 * entry.attitude_noise.array / np.sqrt(SAMPLES))


def test_rotor_speed_noise(robot: Robot) -> None:
    sensors = Sensors(Plant(robot), robot, seed=7)
    values = np.array([sensors.rotor_speed()["thrust_measured"] for _ in range(SAMPLES)])
    sigma = float(robot.file.sensors.rotor_speed.thrust_noise.array)
    assert values.shape == (SAMPLES, len(robot.rotors))
    np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.03)
    np.testing.assert_allclose(values.mean(axis=0), robot.hover_thrust, atol=5 * sigma / np.sqrt(SAMPLES))


def test_imu_measures_specific_force_at_its_site_in_the_bodys_axes(octorotor: Robot, tmp_path: Path) -> None:
    """Octorotor: the IMU is off the centre of mass and turned; without noise it obeys rigid-body kinematics."""
    text = (octorotor.folder / "robot.toml").read_text()
    for value in ("0.1,", "0.08,", "0.005,"):
        text = text.replace(f"value = {value}", "value = 0.0,")
    (tmp_path / "robot.toml").write_text(text)
    (tmp_path / "plant.xml").write_text((octorotor.folder / "plant.xml").read_text())
    robot = load_robot(tmp_path)
    plant = Plant(robot)
    plant.reset(q_WB=np.array([0.6, 0.0, 0.8, 0.0]))
    plant.data.qvel[3:6] = w = np.array([0.7, -1.1, 2.0])
    mujoco.mj_forward(plant.model, plant.data)
    plant.command(robot.hover_thrust + np.linspace(-1.0, 1.0, 8))
    R_WB = plant.data.xmat[plant.base_id].reshape(3, 3).copy()
    sensors = Sensors(plant, robot, seed=0)
    plant.step()
    a_WB, alpha = plant.data.qacc[:3], plant.data.qacc[3:6]
    a_I = R_WB.T @ (a_WB + robot.gravity * np.array([0.0, 0.0, 1.0]))
    a_I += np.cross(alpha, robot.p_BI) + np.cross(w, np.cross(w, robot.p_BI))
    sample = sensors.imu()
    np.testing.assert_allclose(sample["accelerometer_B"], a_I, atol=1e-10)
    np.testing.assert_allclose(sample["gyro_B"], plant.truth()["w_B"], atol=1e-12)


def test_equal_seeds_give_equal_samples(robot: Robot) -> None:
    plant = Plant(robot)
    first, second, third = (Sensors(plant, robot, seed) for seed in (1, 1, 2))
    for name in ("imu", "motion_capture", "rotor_speed"):
        a, b, c = (getattr(sensors, name)() for sensors in (first, second, third))
        assert a
        for key in a:
            np.testing.assert_array_equal(a[key], b[key])
            assert (a[key] != c[key]).any()


def test_rates_are_those_of_robot_toml(tilt_hex: Robot) -> None:
    """ryll2019 'Hardware'."""
    sensors = Sensors(Plant(tilt_hex), tilt_hex, seed=0)
    assert (sensors.imu_rate, sensors.mocap_rate) == (500.0, 100.0)


SPOILT = {
    "negative noise": (("robot.toml", "value = 0.1,", "value = -0.1,"), "accelerometer_noise"),
    "wrong unit": (("robot.toml", '"rad/s"', '"deg/s"'), "gyro_noise"),
    "two numbers": (("robot.toml", "value = 0.0005", "value = [0.1, 0.1]"), "position_noise"),
    "no accelerometer": (("plant.xml", '<accelerometer site="autopilot"/>', ""), "no accelerometer"),
    "no gyro": (("plant.xml", '<gyro site="autopilot"/>', ""), "no gyro"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_bad_sensors_are_refused(case: str, octorotor: Robot, tmp_path: Path) -> None:
    change, named = SPOILT[case]
    robot = load_robot(folder_with(octorotor, tmp_path, change))
    with pytest.raises(RobotError, match=named):
        Sensors(Plant(robot), robot, seed=0)
