"""Sensors: what the robot measures of a plant, with noise and bias from robot.toml."""

import mujoco
import numpy as np

from aerotact.exceptions import RobotError
from aerotact.plant.camera import DepthCamera
from aerotact.plant.joint_sensors import JointSensors
from aerotact.plant.plant import Plant
from aerotact.ports import Array
from aerotact.robot import Robot
from aerotact.robot_file import ForceTorqueEntry, Quantity


class Sensors:
    """Simulated sensors; each call is one sample, so call them at their rates.

    Attributes:
        imu_rate: Hz.
        mocap_rate: Hz.
        force_torque_rate: Hz, or None without that sensor.
        depth_camera: the robot's, or None; its noise has a stream of its own.
        joints: sensors of arms and passive joints.
        biases: errors drawn once from the seed: accelerometer_B (m/s2) and gyro_B (rad/s), constant, and of a
            force/torque sensor f_sensor_S (N), which walks, and tau_sensor_S (N m); shape (3,) each.
    """

    def __init__(self, plant: Plant, robot: Robot, seed: int) -> None:
        """Draw the biases.

        Args:
            plant: what is measured.
            robot: whose robot.toml gives rates, noises and biases.
            seed: of all noise; equal seeds and equal calls give equal samples.

        Raises:
            RobotError: plant.xml lacks a sensor at the site that robot.toml names, a noise is negative, of the wrong
                unit, or not one or three numbers, or rotors tilt and no encoder measures it; or as DepthCamera.
        """
        self._plant = plant
        self._file = robot.folder / "robot.toml"
        self._rng = np.random.default_rng(seed)
        entries = robot.file.sensors
        self.imu_rate = entries.imu.rate
        self.mocap_rate = entries.motion_capture.rate
        imu, mocap, rotor = entries.imu, entries.motion_capture, entries.rotor_speed
        self._accelerometer_noise = self._level("imu.accelerometer_noise", imu.accelerometer_noise, "m/s^2")
        self._gyro_noise = self._level("imu.gyro_noise", imu.gyro_noise, "rad/s")
        self._position_noise = self._level("motion_capture.position_noise", mocap.position_noise, "m")
        self._attitude_noise = self._level("motion_capture.attitude_noise", mocap.attitude_noise, "rad")
        self._thrust_noise = self._level("rotor_speed.thrust_noise", rotor.thrust_noise, "N")
        self.biases: dict[str, Array] = {
            "accelerometer_B": self._level("imu.accelerometer_bias", imu.accelerometer_bias, "m/s^2") * self._normal(),
            "gyro_B": self._level("imu.gyro_bias", imu.gyro_bias, "rad/s") * self._normal(),
        }
        model = plant.model
        self._tilt_noise = self._encoder_noise(robot)
        R_BI = np.zeros(9)
        mujoco.mju_quat2Mat(R_BI, model.site_quat[plant.imu_id])
        if model.site_bodyid[plant.imu_id] != plant.base_id:
            raise RobotError(
                robot.folder / "plant.xml",
                f"site '{robot.file.robot.imu}'",
                "is not on the base body",
                f"put it into body '{robot.file.robot.base}'",
            )
        camera = entries.depth_camera
        # A child of the seed, so that the other sensors' noise is the same with and without a camera.
        stream = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])
        self.depth_camera = DepthCamera(plant, robot, camera, stream) if camera else None
        self._R_BI = R_BI.reshape(3, 3)
        kinds, imu_site = mujoco.mjtSensor, robot.file.robot.imu
        self._accelerometer = self._address(robot, kinds.mjSENS_ACCELEROMETER, "accelerometer", imu_site)
        self._gyro = self._address(robot, kinds.mjSENS_GYRO, "gyro", imu_site)
        self.force_torque_rate: float | None = None
        if entries.force_torque is not None:
            self._begin_force_torque(robot, entries.force_torque)
        self.joints = JointSensors(plant, robot, self._rng)

    def _encoder_noise(self, robot: Robot) -> Array:
        entry = robot.file.sensors.tilt_encoder
        if (entry is None) == bool(robot.tilts):
            fault = f"{len(robot.tilts)} rotors tilt, and there is {'no' if entry is None else 'an'} encoder"
            remedy = "give sensors.tilt_encoder if rotors tilt, and only then"
            raise RobotError(self._file, "sensors.tilt_encoder", fault, remedy)
        return np.zeros(()) if entry is None else self._level("tilt_encoder.angle_noise", entry.angle_noise, "rad")

    def _begin_force_torque(self, robot: Robot, entry: ForceTorqueEntry) -> None:
        part, kinds = "force_torque", mujoco.mjtSensor
        self.force_torque_rate = entry.rate
        self._force_noise = self._level(f"{part}.force_noise", entry.force_noise, "N")
        self._torque_noise = self._level(f"{part}.torque_noise", entry.torque_noise, "N m")
        self._drift = self._level(f"{part}.drift", entry.drift, "N/sqrt(s)") / np.sqrt(entry.rate)
        self._force = self._address(robot, kinds.mjSENS_FORCE, "force", entry.site)
        self._torque = self._address(robot, kinds.mjSENS_TORQUE, "torque", entry.site)
        self.biases["f_sensor_S"] = self._level(f"{part}.force_bias", entry.force_bias, "N") * self._normal()
        self.biases["tau_sensor_S"] = self._level(f"{part}.torque_bias", entry.torque_bias, "N m") * self._normal()

    def _normal(self) -> Array:
        return self._rng.normal(size=3)

    def _level(self, part: str, quantity: Quantity, unit: str) -> Array:
        level = quantity.array
        if quantity.unit != unit or level.shape not in ((), (3,)) or not (np.isfinite(level) & (level >= 0.0)).all():
            raise RobotError(
                self._file,
                f"sensors.{part}",
                f"is {quantity.value} {quantity.unit}",
                f"give a standard deviation >= 0 in {unit}, one number or one an axis",
            )
        return level

    def _address(self, robot: Robot, kind: mujoco.mjtSensor, label: str, name: str) -> slice:
        """Where the sensor of this kind at the site of this name lies in sensordata."""
        model = self._plant.model
        site = model.site(name).id
        found = np.flatnonzero((model.sensor_type == kind) & (model.sensor_objid == site))
        if found.size == 0:
            raise RobotError(
                robot.folder / "plant.xml", "sensor", f"no {label} at site '{name}'", f'add <{label} site="{name}"/>'
            )
        start = int(model.sensor_adr[found[0]])
        return slice(start, start + 3)

    def imu(self) -> dict[str, Array]:
        """One sample of the inertial measurement unit, turned into B's axes.

        Returns:
            accelerometer_B: specific force at the IMU's site (not at the centre of mass), m/s2, as it was over the step
                that led to the plant's time, since an acceleration belongs to a step and not to an instant;
            gyro_B: angular velocity at the plant's time, rad/s.
        """
        data = self._plant.data.sensordata
        accelerometer = self._R_BI @ data[self._accelerometer] + self.biases["accelerometer_B"]
        gyro = self._R_BI @ data[self._gyro] + self.biases["gyro_B"]
        return {
            "accelerometer_B": accelerometer + self._accelerometer_noise * self._normal(),
            "gyro_B": gyro + self._gyro_noise * self._normal(),
        }

    def motion_capture(self) -> dict[str, Array]:
        """One sample of the motion capture.

        Returns:
            mocap_p_WB: position of the body's origin, m;
            mocap_q_WB: attitude wxyz of unit length, turned by a small random rotation vector in B's axes.
        """
        truth = self._plant.base_pose()
        turn, q_WB = np.zeros(4), np.zeros(4)
        angle = self._attitude_noise * self._normal()
        size = float(np.linalg.norm(angle))
        mujoco.mju_axisAngle2Quat(turn, angle / size if size > 0.0 else np.array([1.0, 0.0, 0.0]), size)
        mujoco.mju_mulQuat(q_WB, truth[3:], turn)
        return {"mocap_p_WB": truth[:3] + self._position_noise * self._normal(), "mocap_q_WB": q_WB}

    def rotor_speed(self) -> dict[str, Array]:
        """One sample of the rotor speeds, given as thrusts.

        Returns:
            thrust_measured: actual thrust with noise, N, shape (n,), in the order of `robot.rotors`.
        """
        thrust = self._plant.thrust()
        return {"thrust_measured": thrust + self._thrust_noise * self._rng.normal(size=thrust.size)}

    def tilt_encoder(self) -> dict[str, Array]:
        """One sample of the tilt servos' encoders; nothing if nothing tilts.

        Returns:
            tilt_measured: angle of each servo's shaft with noise, rad, shape (m,), in the order of `robot.tilts`; play
                and zero error between shaft and rotor are not seen.
        """
        shaft = self._plant.servos.shaft()
        if not shaft.size:
            return {}
        return {"tilt_measured": shaft + self._tilt_noise * self._rng.normal(size=shaft.size)}

    def force_torque(self) -> dict[str, Array]:
        """One sample of the force/torque sensor, as it was over the last step; nothing if there is none.

        Returns:
            f_sensor_S (N), tau_sensor_S (N m, about the sensor's site): what the robot exerts through the sensor on
            what the sensor carries, in the site's axes. At rest that is the force of the tool on the environment minus
            the tool's weight (a vector that points down), plus bias and noise.
        """
        if self.force_torque_rate is None:
            return {}
        self.biases["f_sensor_S"] = self.biases["f_sensor_S"] + self._drift * self._normal()
        data = self._plant.data.sensordata
        force = data[self._force] + self.biases["f_sensor_S"] + self._force_noise * self._normal()
        torque = data[self._torque] + self.biases["tau_sensor_S"] + self._torque_noise * self._normal()
        return {"f_sensor_S": force, "tau_sensor_S": torque}
