"""Sensors: what they measure without noise, their statistics, their seeds and bad entries of robot.toml."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hand import Hand

from aerotact.exceptions import RobotError
from aerotact.plant.mismatch import TiltError
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


def test_encoder_measures_the_shaft_and_not_the_rotor(tilting: Robot) -> None:
    plant = Plant(tilting, disturbances=[TiltError(np.deg2rad(2.0))])
    plant.command(tilting.hover_thrust, np.resize([0.2, -0.2], 6))
    for _ in range(1000):
        plant.step()
    sensors = Sensors(plant, tilting, seed=8)
    values = np.array([sensors.tilt_encoder()["tilt_measured"] for _ in range(SAMPLES)])
    assert tilting.file.sensors.tilt_encoder is not None
    sigma = float(tilting.file.sensors.tilt_encoder.angle_noise.array)
    np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.03)
    np.testing.assert_allclose(values.mean(axis=0), np.resize([0.2, -0.2], 6), atol=5 * sigma / np.sqrt(SAMPLES) + 1e-8)
    np.testing.assert_allclose(plant.truth()["tilt"] - values.mean(axis=0), np.deg2rad(2.0), atol=1e-4)


def test_robot_without_these_sensors_gives_nothing(octorotor: Robot) -> None:
    sensors = Sensors(Plant(octorotor), octorotor, seed=0)
    assert sensors.tilt_encoder() == sensors.force_torque() == {}
    assert sensors.force_torque_rate is None


SILENT = [("robot.toml", f"{name} = {{ value = {value}", f"{name} = {{ value = 0.0") for name, value in (
    ("force_noise", 0.05), ("torque_noise", 0.002), ("force_bias", 0.3), ("torque_bias", 0.01), ("drift", 0.01),
)]  # fmt: skip


@pytest.mark.parametrize("q_WB", [[1.0, 0, 0, 0], [0.7, 0.1, -0.5, 0.5]])
def test_force_sensor_gives_what_the_robot_does_to_the_environment(
    tilting: Robot, tmp_path: Path, q_WB: list[float]
) -> None:
    """At rest in any attitude, the tip pushed by the environment off its axis: its reaction, and the weight held."""
    robot = load_robot(folder_with(tilting, tmp_path, *SILENT))
    plant = Plant(robot)
    plant.reset(q_WB=np.array(q_WB) / np.linalg.norm(q_WB))
    plant.model.opt.gravity[:] = 0.0  # held: no acceleration, so that gravity acts on what the sensor carries only
    sensor, R_WS = robot.force_torque, plant.data.site("force_torque").xmat.reshape(3, 3)
    assert sensor is not None
    f_env_W, offset_E = np.array([-5.0, 1.0, 0.5]), np.array([0.01, -0.005, 0.0])
    weight_W = np.array([0.0, 0.0, -sensor.distal_mass * robot.gravity])
    body, tip_W = plant.tip.body, plant.truth()["p_WE"]
    R_WE = plant.data.site_xmat[plant.tip.site].reshape(3, 3)
    for force, place in ((f_env_W, tip_W + R_WE @ offset_E), (weight_W, plant.data.xipos[body])):
        plant.push(body, force, place)
        plant.push(plant.base_id, -force, place)  # the hand that holds it
    plant.command(np.full(6, 0.2))
    plant.data.act[:6] = 0.0
    mujoco.mj_forward(plant.model, plant.data)
    assert np.abs(plant.data.qacc).max() < 1e-9
    sample = Sensors(plant, robot, seed=0).force_torque()
    np.testing.assert_allclose(sample["f_sensor_S"], R_WS.T @ -(f_env_W + weight_W), atol=1e-9)
    p_SE = sensor.R_BS.T @ (robot.p_BE + robot.R_BE @ offset_E - sensor.p_BS)
    torque_S = np.cross(p_SE, R_WS.T @ -f_env_W) + np.cross(sensor.p_SD, R_WS.T @ -weight_W)
    np.testing.assert_allclose(sample["tau_sensor_S"], torque_S, atol=1e-9)


def test_force_sensor_feels_a_wall(tilting: Robot, tmp_path: Path) -> None:
    """Pressed against a wall in front: the force on the wall is along the tool, so that z of S is positive."""
    robot = load_robot(folder_with(tilting, tmp_path, *SILENT))
    plant = Plant(robot, "wall", disturbances=[Hand(np.array([5.0, 0, 0]), np.zeros(3), 100.0)])
    face = plant.model.geom("surface_wall").pos[0] - plant.model.geom("surface_wall").size[0]
    plant.reset(p_WB=[face - robot.p_BE[0] - 0.001, 0.0, 1.5])
    sensors = Sensors(plant, robot, seed=0)
    for _ in range(3000):
        plant.step()
    force = plant.truth()["f_contact_W"]
    assert force[0] == pytest.approx(-5.0, abs=0.05)
    sample, sensor = sensors.force_torque(), robot.force_torque
    assert sensor is not None
    R_WS = plant.data.site("force_torque").xmat.reshape(3, 3)
    held_W = np.array([0.0, 0.0, sensor.distal_mass * robot.gravity])
    np.testing.assert_allclose(sample["f_sensor_S"], R_WS.T @ (held_W - force), atol=5e-3)
    assert sample["f_sensor_S"][2] > 4.9


def test_force_sensor_has_noise_bias_and_drift(tilting: Robot) -> None:
    entry = tilting.file.sensors.force_torque
    assert entry is not None
    plant, seconds = Plant(tilting), 20.0
    ends, starts = [], []
    for seed in range(200):
        sensors = Sensors(plant, tilting, seed)
        starts.append(sensors.biases["f_sensor_S"].copy())
        samples = [sensors.force_torque() for _ in range(int(seconds * entry.rate))] if seed < 20 else []
        if samples:
            ends.append(sensors.biases["f_sensor_S"] - starts[-1])
        if seed == 0:
            force, torque = (np.array([s[n] for s in samples]) for n in ("f_sensor_S", "tau_sensor_S"))
            assert np.diff(force, axis=0).std() == pytest.approx(np.sqrt(2) * entry.force_noise.array, rel=0.03)
            np.testing.assert_allclose(torque.std(axis=0), entry.torque_noise.array, rtol=0.03)
    np.testing.assert_allclose(np.std(starts), entry.force_bias.array, rtol=0.1)
    np.testing.assert_allclose(np.std(ends), entry.drift.array * np.sqrt(seconds), rtol=0.3)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("robot.toml", 'unit = "rad", source = "data sheet', 'unit = "deg", source = "data sheet'), "tilt_encoder"),
        (("robot.toml", "[sensors.tilt_encoder]", "[gains.x]"), "tilt_encoder"),
        (("robot.toml", 'unit = "N/sqrt(s)"', 'unit = "N/s"'), "force_torque.drift"),
        (("plant.xml", '<force name="force" site="force_torque"/>', ""), "sensor"),
        (("plant.xml", '<torque name="torque" site="force_torque"/>', ""), "sensor"),
    ],
)
def test_bad_sensors_of_tilting_rotors_are_refused(
    tilting: Robot, tmp_path: Path, change: tuple[str, str, str], named: str
) -> None:
    robot = load_robot(folder_with(tilting, tmp_path, change))
    with pytest.raises(RobotError, match=named):
        Sensors(Plant(robot), robot, seed=0)


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
