"""The momentum observer of bodie2021 (5)-(6): time constant, integral form, and beside the observer of ryll2019."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from stepping import Flight, Runner, rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.momentum_observer import momentum_observer
from aerotact.estimation.wrench_observer import wrench_observer
from aerotact.ports import Array, Block

RATE = 200.0
K_LIN, K_ANG = 3.0, 5.0


def _observer(model: Model, rate: float = RATE, k_lin: float = K_LIN, k_ang: float = K_ANG) -> Block:
    return momentum_observer(model, rate).with_parameters({"K_I_lin": k_lin, "K_I_ang": k_ang})


def _upright(model: Model) -> dict[str, Array]:
    y = {"q_WB": np.array([1.0, 0, 0, 0]), "thrust_measured": model.robot.hover_thrust}
    return y | ({"tilt_measured": model.robot.hover_tilt} if model.tilts else {})


@pytest.mark.parametrize("rate", [20.0, 200.0, 1000.0])
def test_force_converges_as_6_says_at_any_rate(model: Model, rate: float) -> None:
    f, run = np.array([1.0, -2.0, 3.0]), Runner(_observer(model, rate))
    for k in range(round(2 * rate)):
        out = run({**_upright(model), "v_WB": f / model.robot.mass * k / rate})
        np.testing.assert_allclose(out["f_ext_W"], f * (1 - np.exp(-K_LIN * k / rate)), atol=1e-9)


def test_torque_converges_as_6_says(tilting: Model) -> None:
    """Spun up about each axis of B by a known torque; the inertia has no products, so no gyroscopic torque arises."""
    robot = tilting.robot
    for axis in range(3):
        tau, run = 0.2 * np.eye(3)[axis], Runner(_observer(tilting))
        for k in range(201):
            w_B = np.linalg.solve(robot.J_C, tau) * k / RATE
            out = run({**_upright(tilting), "w_B": w_B})
            np.testing.assert_allclose(out["tau_ext_B"], tau * (1 - np.exp(-K_ANG * k / RATE)), atol=1e-6)


def _motion(t: float) -> tuple[Array, Array, Array]:
    """A tumbling motion: R_WB, v_WB, w_B."""
    axis = np.array([0.6, -0.64, 0.48])
    R_WB = Rotation.from_rotvec((1.2 * np.sin(1.5 * t)) * axis).as_matrix()
    return R_WB, np.array([np.sin(2 * t), 0.5 * np.cos(t), 0.3 * t]), 1.8 * np.cos(1.5 * t) * axis


def test_equals_the_integral_form_of_5(tilting: Model) -> None:
    """tau_hat = K_I (M v - p_0 - int(tau - C v - g + tau_hat) dt) in B, integrated finely, at hover thrust."""
    robot = tilting.robot
    K = np.repeat([K_LIN, K_ANG], 3)
    rotors = np.array([0, 0, robot.mass * robot.gravity, 0, 0, 0])

    def momentum(t: float) -> Array:
        R, v, w = _motion(t)
        return np.concatenate([robot.mass * (R.T @ v + np.cross(w, robot.p_BC)), robot.J_C @ w])

    def known(t: float) -> Array:
        R, v, w = _motion(t)
        coriolis = np.concatenate(
            [robot.mass * np.cross(w, R.T @ v + np.cross(w, robot.p_BC)), -np.cross(robot.J_C @ w, w)]
        )
        return rotors - coriolis - np.concatenate([robot.mass * R.T @ [0, 0, robot.gravity], np.zeros(3)])

    start = momentum(0.0)
    s = solve_ivp(
        lambda t, i: known(t) + K * (momentum(t) - start - i), (0, 3), np.zeros(6), rtol=1e-9, atol=1e-9, max_step=0.01
    )
    wanted = K * (momentum(3.0) - start - s.y[:, -1])
    rate = 1000.0
    run = Runner(_observer(tilting, rate))
    for k in range(round(3 * rate) + 1):
        R, v, w = _motion(k / rate)
        q = Rotation.from_matrix(R).as_quat(scalar_first=True)
        out = run({**_upright(tilting), "q_WB": q, "v_WB": v, "w_B": w})
    found = np.concatenate([rotation(q).T @ out["f_ext_W"], out["tau_ext_B"]])
    assert np.abs(wanted[:3]).max() > 5, "the motion must need forces"
    np.testing.assert_allclose(found[:3], wanted[:3], atol=0.02)
    np.testing.assert_allclose(found[3:], wanted[3:], atol=2e-3)


def test_printed_form_of_5_swings_without_damping() -> None:
    """With the dot on the left, tau_hat'' = K_I (tau - tau_hat) goes to 6 N on a step of 3 N and never settles."""
    step = 3.0
    printed = solve_ivp(lambda t, x: [x[1], K_LIN * (step - x[0])], (0, 20), [0.0, 0.0], rtol=1e-9, max_step=0.01)
    assert printed.y[0].max() == pytest.approx(2 * step, abs=1e-3)
    assert printed.y[0][printed.t > 15].max() == pytest.approx(2 * step, abs=1e-3)


def _both(model: Model, flight: Flight) -> tuple[dict[str, Array], dict[str, Array]]:
    """This observer's estimates and those of ryll2019's, with equal bandwidths, after 1.5 s of the same flight."""
    other = wrench_observer(model, RATE).with_parameters({"L": K_LIN, "K_I": K_ANG})
    runs = Runner(_observer(model)), Runner(other)
    for _ in range(300):
        flight.step(model.robot.hover_thrust)
        found = [run(flight.signals()) for run in runs]
    return found[0], found[1]


def test_torque_is_that_of_the_observer_of_ryll2019(model: Model) -> None:
    """While the robot tumbles: (5) and ryll2019 (23) are the same law of the torque."""
    flight = Flight(model, 1 / RATE)
    flight.f_W, flight.tau_W = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])
    momentum, accelerometer = _both(model, flight)
    assert np.linalg.norm(accelerometer["tau_ext_B"]) > 0.02
    np.testing.assert_allclose(momentum["tau_ext_B"], accelerometer["tau_ext_B"], atol=1e-9)


def test_force_is_that_of_the_accelerometer_while_the_robot_does_not_turn(model: Model) -> None:
    """A force through the centre of mass; in turns the two differ, since (5) filters in B and ryll2019 (19) in W."""
    flight = Flight(model, 1 / RATE)
    flight.f_W = np.array([0.3, -0.2, 0.1])
    p_CE_W = rotation(flight.x[3:7]) @ (model.robot.p_BE - model.robot.p_BC)
    flight.tau_W = -np.cross(p_CE_W, flight.f_W)
    momentum, accelerometer = _both(model, flight)
    np.testing.assert_allclose(momentum["f_ext_W"], accelerometer["f_ext_W"], atol=2e-3)
    assert np.linalg.norm(accelerometer["f_ext_W"]) > 0.35
