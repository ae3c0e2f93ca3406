"""Angles and rates of joints, and the wrench on a robot with joints: against closed forms and MuJoCo's truth."""

from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest
from stepping import Runner

from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.estimation.joint_estimator import joint_estimator, track
from aerotact.estimation.multibody_observer import multibody_observer
from aerotact.exceptions import MissingCapability
from aerotact.plant.disturbance import ToolForce, Wind
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
RATE = 250.0
EVERY = 4  # physics steps


@pytest.fixture(scope="module", params=["dual_arm_long_reach", "dual_arm_standard"])
def arms(request: pytest.FixtureRequest) -> Multibody:
    model = model_of(load_robot(MODELS / request.param))
    assert isinstance(model, Multibody)
    return model


def test_filter_is_exact_on_a_steady_rate_and_has_its_bandwidth() -> None:
    q, v = 0.0, 0.0
    for k in range(1, 400):
        q, v = track(q, v, 0.3 * k / RATE, 60.0, 1 / RATE)
    assert float(q) == pytest.approx(0.3 * 399 / RATE, abs=1e-9)
    assert float(v) == pytest.approx(0.3, abs=1e-9)
    q, v = 0.0, 0.0  # on a step both errors die as two equal poles exp(-60 t)
    for _ in range(25):
        q, v = track(q, v, 1.0, 60.0, 1 / RATE)
    pole = np.exp(-60.0 / RATE)
    x, e = ca.SX.sym("x", 2), ca.SX(0)
    F = ca.Function("F", [x], [ca.jacobian(ca.vertcat(*track(x[0], x[1], e, 60.0, 1 / RATE)), x)])
    np.testing.assert_allclose(np.linalg.eigvals(F([0, 0]).full()), [pole, pole], atol=1e-7)


def test_at_hover_the_angles_are_those_of_hover(arms: Multibody) -> None:
    run = Runner(joint_estimator(arms, RATE))
    for _ in range(50):
        out = run({})
    np.testing.assert_allclose(out["joint"], arms.hover_joint, atol=1e-9)
    np.testing.assert_allclose(out["joint_rate"], 0.0, atol=1e-9)


def test_moving_joints_are_followed(arms: Multibody) -> None:
    """The left arm and the pendulum move in MuJoCo; sensors with their noise, bias and steps."""
    plant = Plant(arms.robot)
    sensors, run = Sensors(plant, arms.robot, 3), Runner(joint_estimator(arms, RATE))
    if arms.passive:
        plant.data.qpos[7] += np.deg2rad(5.0)
        mujoco.mj_forward(plant.model, plant.data)
    hover, servo = arms.robot.hover_thrust, arms.hover_servo.copy()
    errors, rates, swings = [], [], []
    held: dict[str, Array] = sensors.joints.samples()
    for k in range(800):
        servo[:4] = arms.hover_servo[:4] + 0.2 * (1 - np.cos(2 * k * 1e-3)) * np.array([1, 0.5, 0, -1])
        plant.command(hover, servo=servo)
        for name, rate in sensors.joints.rates.items():
            if k % round(1000 / rate) == 0:
                held |= sensors.joints.sample(name)
        if k % EVERY == 0:
            truth = plant.truth()
            out = run({"q_WB": truth["q_WB"], **held})
            if k > 200:
                errors.append(out["joint"] - truth["joint"])
                rates.append(out["joint_rate"] - truth["joint_rate"])
                swings.append(truth["joint_rate"][0])
        plant.step()
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    rate_rms = np.sqrt(np.mean(np.square(rates), axis=0))
    print(arms.robot.name, "angle rms mrad", 1e3 * rms, "rate rms", rate_rms)
    if arms.passive:
        assert rms[0] < 0.012  # the encoder's bias, and 17 ms of lag at its rate
        assert rate_rms[0] < 0.25 * np.std(swings)
    assert rms.max() < 0.05


@pytest.mark.parametrize("kind", ["wind", "tool"])
def test_observer_finds_an_outer_force_and_not_the_swing(arms: Multibody, kind: str) -> None:
    """1 N from 1 s on while the arms move and the pendulum swings freely: approached as 1 - exp(-t)."""
    push = (Wind if kind == "wind" else ToolForce)((1.0, 0.5, 0.0), 1.0, 9.0)
    plant = Plant(arms.robot, disturbances=[push])
    if arms.passive:
        plant.data.qpos[7] += np.deg2rad(10.0)
        mujoco.mj_forward(plant.model, plant.data)
    servo, run, found, torque = arms.hover_servo.copy(), Runner(multibody_observer(arms, RATE)), [], []
    lever = plant.truth()["p_WE"] - plant.truth()["p_WB"]
    for k in range(1600):
        servo[[0, 4]] = arms.hover_servo[[0, 4]] + 0.2 * np.sin(4e-3 * k)
        plant.command(arms.robot.hover_thrust, servo=servo)
        if k % EVERY == 0:
            out = run({**plant.truth(), "thrust_measured": plant.thrust()})
            found.append(out["f_ext_W"])
            torque.append(out["tau_ext_B"])
        plant.step()
    before, after = np.array(found[:240]), np.array(found)[[-1]]
    print(arms.robot.name, kind, "before", np.abs(before).max(), "after", after, torque[-1])
    assert np.abs(before).max() < 0.02
    assert np.abs(torque[239]).max() < 0.02
    expected = 1 - np.exp(-0.596)
    np.testing.assert_allclose(after[0], expected * np.array([1.0, 0.5, 0.0]), atol=0.02)
    if kind == "tool":
        np.testing.assert_allclose(torque[-1], expected * np.cross(lever, [1.0, 0.5, 0.0]), atol=0.12)


def test_a_rigid_robot_has_nothing_to_estimate(hexarotor: Model) -> None:
    for build in (joint_estimator, multibody_observer):
        with pytest.raises(MissingCapability, match=r"needs arm or passive_joint, which robot 'tilt_hex'"):
            build(hexarotor, RATE)
