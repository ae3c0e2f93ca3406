"""The wrench observer of ryll2019 (18)-(25): sign, time constants, lever arms and the learnt offset."""

import numpy as np
import pytest
from stepping import Flight, Runner, rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.wrench_observer import wrench_observer
from aerotact.ports import Array, Block

RATE = 500.0
L, K_I = 10.0, 7.0


def _observer(model: Model, rate: float = RATE, **more: float) -> Block:
    return wrench_observer(model, rate).with_parameters({"L": L, "K_I": K_I, "low_pass": 20.0} | more)


def _at_rest(model: Model, f_B: Array) -> dict[str, Array]:
    """What is measured at rest under hover thrust with a force of the environment at the centre of mass."""
    robot = model.robot
    force = f_B / robot.mass + [0, 0, robot.gravity]
    return {"specific_force_B": force, "thrust_measured": robot.hover_thrust}


def test_force_converges_with_the_time_constant_of_20(model: Model) -> None:
    f = np.array([1.0, -2.0, 3.0])
    run = Runner(_observer(model))
    y = _at_rest(model, f)
    for k in range(1, 301):
        estimate = run(y)["f_ext_W"]
        np.testing.assert_allclose(estimate, f * (1 - np.exp(-L * k / RATE)), atol=1e-9)


def test_torque_converges_with_the_time_constant_of_24(hexarotor: Model) -> None:
    """Spun up about a principal axis by a known torque, so that the momentum is known exactly."""
    robot = hexarotor.robot
    for axis in range(3):
        tau = 0.2 * np.eye(3)[axis]
        run = Runner(_observer(hexarotor))
        y = _at_rest(hexarotor, np.zeros(3))
        for k in range(201):
            w_B = np.linalg.solve(robot.J_C, tau) * k / RATE
            estimate = run({**y, "w_B": w_B})["tau_ext_B"]
            np.testing.assert_allclose(estimate, tau * (1 - np.exp(-K_I * k / RATE)), atol=1e-9)


@pytest.mark.parametrize(("rate", "bandwidth"), [(20.0, 200.0), (500.0, 10.0), (500.0, 5000.0)])
def test_stable_at_any_rate(model: Model, rate: float, bandwidth: float) -> None:
    f = np.array([0.5, 0.0, 0.0])
    run = Runner(_observer(model, rate, L=bandwidth, K_I=bandwidth))
    estimates = [run(_at_rest(model, f))["f_ext_W"][0] for _ in range(int(rate))]
    assert np.all(np.diff(estimates) >= -1e-12)
    assert estimates[-1] == pytest.approx(0.5, abs=1e-3)


def test_wrench_at_the_tip_is_found_in_free_motion(model: Model) -> None:
    """Tumbling under hover thrust, pushed off the centre of mass: the sign is that of the environment on the robot."""
    flight, run = Flight(model), Runner(_observer(model, L=50.0, K_I=50.0))
    flight.f_W, flight.tau_W = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])
    flight.x[10:13] = [0.6, -0.4, 0.8]
    for _ in range(200):
        y = flight.signals()
        out = run(y)
        flight.step(model.robot.hover_thrust)
    np.testing.assert_allclose(out["f_ext_W"], flight.f_W, atol=5e-3)
    np.testing.assert_allclose(out["tau_ext_B"], y["truth"][3:], atol=5e-3)
    np.testing.assert_allclose(out["f_tool_W"], flight.f_W, atol=5e-3)
    np.testing.assert_allclose(out["tau_tool_W"], flight.tau_W, atol=8e-3)


def test_own_thrusts_and_tilts_are_not_taken_for_a_wrench(model: Model) -> None:
    """Shaken and turned by its own rotors in free flight."""
    flight, run = Flight(model), Runner(_observer(model, L=50.0, K_I=50.0))
    pattern = np.resize([1.0, -0.5, 0.2, -0.7, -0.1], model.rotors)
    worst = []
    for k in range(500):
        out = run(flight.signals())
        worst.append([np.abs(out["f_ext_W"]).max(), np.abs(out["tau_ext_B"]).max()])
        swing = np.sin(30 * k / RATE)
        tilt = model.robot.hover_tilt + 0.2 * np.resize(pattern, model.tilts) * swing
        flight.step(model.robot.hover_thrust + 1.5 * pattern * swing, tilt)
    assert np.abs(flight.x[10:13]).max() > 0.05
    assert (np.max(worst, axis=0) < 6e-4).all()


def test_force_at_the_centre_of_mass_is_moved_to_the_tip_by_25(model: Model) -> None:
    """Held still in a turned attitude by a force alone: about the tip that force has a torque."""
    q_WB = np.array([0.8, 0.0, 0.6, 0.0])
    R_WB, robot = rotation(q_WB), model.robot
    weight_W = np.array([0, 0, robot.mass * robot.gravity])
    f_W = weight_W - R_WB @ weight_W  # hover thrust pushes along B's z
    y = {
        "q_WB": q_WB,
        "thrust_measured": robot.hover_thrust,
        "specific_force_B": R_WB.T @ [0, 0, robot.gravity],
    }
    run = Runner(_observer(model))
    for _ in range(1000):
        out = run(y)
    np.testing.assert_allclose(out["f_ext_W"], f_W, atol=1e-5)
    np.testing.assert_allclose(out["tau_ext_B"], np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(out["f_tool_W"], f_W, atol=1e-5)
    lever_W = R_WB @ (robot.p_BC - robot.p_BE)
    np.testing.assert_allclose(out["tau_tool_W"], np.cross(lever_W, f_W), atol=1e-5)


def test_printed_sign_of_19_converges_to_minus_the_force(hexarotor: Model) -> None:
    robot, f = hexarotor.robot, 1.4
    acceleration, rotors = f / robot.mass, robot.mass * robot.gravity
    printed = mended = 0.0
    h = 1e-3
    for _ in range(5000):
        residual = robot.mass * acceleration + robot.mass * robot.gravity - rotors
        printed += h * (-L * printed - L * residual)
        mended += h * (-L * mended + L * residual)
    assert printed == pytest.approx(-f, abs=1e-6)
    run = Runner(_observer(hexarotor))
    for _ in range(1000):
        out = run(_at_rest(hexarotor, np.array([0, 0, f])))
    assert out["f_ext_W"][2] == pytest.approx(mended, abs=1e-6)


def test_offset_is_learnt_held_and_kept_out_of_the_tool_wrench_only(model: Model) -> None:
    offset, push = np.array([0.3, -0.2, 0.5]), np.array([1.0, 0.0, 0.0])
    run = Runner(_observer(model))
    for _ in range(1000):
        out = run(_at_rest(model, offset), {"calibrate": 1.0})
    np.testing.assert_allclose(out["f_tool_W"], np.zeros(3), atol=2e-3)
    np.testing.assert_allclose(out["f_ext_W"], offset, atol=1e-6)
    for _ in range(1000):
        out = run(_at_rest(model, offset + push), {"calibrate": 0.0})
    np.testing.assert_allclose(out["f_tool_W"], push, atol=2e-3)
    np.testing.assert_allclose(out["f_ext_W"], offset + push, atol=1e-6)


def test_each_rise_of_calibrate_starts_a_new_mean(model: Model) -> None:
    run = Runner(_observer(model))
    for force, flag in ((0.4, 1.0), (0.4, 0.0), (-0.6, 1.0)):
        for _ in range(600):
            run(_at_rest(model, np.array([force, 0, 0])), {"calibrate": flag})
    learnt = run.block.state.unpack(run.z)["f_offset_W"]
    assert learnt[0] == pytest.approx(-0.6, abs=1e-9)


def test_default_input_is_hover_without_wrench(model: Model) -> None:
    run = Runner(_observer(model))
    for _ in range(10):
        out = run({})
    for value in out.values():
        np.testing.assert_allclose(value, np.zeros(3), atol=1e-12)
