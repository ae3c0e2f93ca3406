"""COM calibration: only rests count, what the turns between them would add, and the goal of 1 mm in flight."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.dynamics.rotors import least_thrust
from aerotact.estimation.calibration import centre_of_mass
from aerotact.experiments.bodie2021.com_calibration import END, OFFSET, RESTS, ComCalibration, steady
from aerotact.flight import fly
from aerotact.ports import Array
from aerotact.robot import load_robot

CALIBRATION = ComCalibration()
CASE = CALIBRATION.cases[0]
TIME = np.arange(0.0, END, 0.01)
GOAL = 1e-3  # m


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(load_robot("tilt_rotor"))


@pytest.fixture(scope="module")
def balanced(model: Model) -> tuple[Array, Array]:
    """Force and torque in B that carry the robot along the reference, its centre of mass off by OFFSET."""
    robot, wanted = model.robot, CALIBRATION.reference(CASE, model).sample(TIME)
    turn_WB = Rotation.from_quat(wanted["q_WE_d"], scalar_first=True) * Rotation.from_matrix(robot.R_BE).inv()
    w, dw = wanted["w_E_d"] @ robot.R_BE.T, wanted["dw_E_d"] @ robot.R_BE.T
    force = robot.mass * turn_WB.inv().apply([0.0, 0.0, robot.gravity])
    return force, np.cross(OFFSET, force) + dw @ robot.J_C + np.cross(w, w @ robot.J_C)


def test_the_robot_is_to_rest_where_rows_count(model: Model) -> None:
    wanted = CALIBRATION.reference(CASE, model).sample(TIME)
    rows = steady(TIME)
    assert len(rows) == pytest.approx(400, abs=4)
    for signal in ("w_E_d", "dw_E_d", "v_WE_d", "a_WE_d"):
        assert np.abs(wanted[signal][rows]).max() < 1e-12
    assert np.abs(wanted["w_E_d"]).max() > 0.1  # it does turn in between
    angles = {tuple(np.round(q, 6)) for q in wanted["q_WE_d"][rows]}
    assert len(angles) == len(RESTS)


def test_turns_put_the_height_wrong_and_rests_do_not(model: Model, balanced: tuple[Array, Array]) -> None:
    force, torque = balanced
    at_rest = centre_of_mass(force[steady(TIME)], torque[steady(TIME)])
    np.testing.assert_allclose(at_rest, OFFSET, atol=1e-12)
    moving = (TIME >= 4.0) & (TIME < 22.5)
    error = centre_of_mass(force[moving], torque[moving]) - OFFSET
    assert np.abs(error[:2]).max() < 5e-4
    assert error[2] > 1e-3


def test_estimate_reads_thrusts_and_tilts_of_the_rests(model: Model, balanced: tuple[Array, Array]) -> None:
    wrench = ca.SX.sym("wrench", 6)
    allocate = ca.Function("allocate", [wrench], list(least_thrust(model.robot, wrench)))
    thrust, tilt = (np.asarray(part).T for part in allocate.map(len(TIME))(np.hstack(balanced).T))
    log = {"time": TIME[:, None], "thrust_measured_est": thrust, "tilt_measured_est": tilt}
    np.testing.assert_allclose(CALIBRATION.estimate(log), OFFSET, atol=1e-7)
    np.testing.assert_allclose(CALIBRATION.estimate(log, RESTS[1][1] + 5.0), OFFSET, atol=1e-7)


@pytest.mark.parametrize("controller", ["law", pytest.param("mpc", marks=pytest.mark.slow)])
def test_an_offset_of_5_mm_is_found_to_1_mm(controller: str) -> None:
    _, result = fly(CALIBRATION, CASE, controller, 0)
    assert result.fault == ""
    for axis, true in zip("xyz", OFFSET, strict=True):
        assert result.metrics[f"com_{axis}"].value == pytest.approx(true, abs=GOAL)
