"""The law of bodie2021 as generated C, flown in MuJoCo on simulated sensors; the surface is told as it truly is."""

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.codegen.project import block_project
from aerotact.controller import Controller
from aerotact.dynamics.model import Model
from aerotact.estimation import estimators
from aerotact.estimation.calibration import centre_of_mass
from aerotact.laws import laws
from aerotact.log import Log
from aerotact.loop import Loop, Wiring
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.plant.mismatch import CentreOfMassError
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array
from aerotact.reference import Reference

LAW = "bodie2021_impedance_force"
RATE = 200.0
WALL = 1.0  # m, x of its face
TUNED = {
    **{"K_lin": 300.0, "D_lin": 60.0, "K_ang": 15.0, "D_ang": 3.0, "K_I_lin": 10.0, "K_I_ang": 6.0},
    **{"m_free": 20.0, "J_v": 20.0, "K_fp": 1.0, "K_fi": 10.0, "force_cutoff": 40.0},
}


class SensorsAndSurface(Sensors):
    """The robot's sensors, and the wall's distance along the tool's axis as it truly is."""

    def imu(self) -> dict[str, Array]:
        at = self._plant.truth()
        axis = self._plant.data.site_xmat[self._plant.tip.site].reshape(3, 3)[:, 2]
        seen = axis[0] > 0.2
        return {
            **super().imu(),
            "surface_distance": np.array([(WALL - at["p_WE"][0]) / max(axis[0], 0.2)]),
            "n_W": np.array([-1.0, 0.0, 0.0]),
            "surface_valid": np.array([float(seen)]),
        }


@dataclass(frozen=True)
class Approach:
    """Tare in hover, at 33 mm/s to `beyond` the wall (m), then a push that rises in a second to each force in turn."""

    pose: tuple[Array, Array]
    beyond: float = 0.0
    forces: dict[float, float] = field(default_factory=dict)

    def sample(self, times: Array) -> dict[str, Array]:
        p_WE, q_WE = self.pose
        n, zero = len(times), np.zeros((len(times), 3))
        goal = WALL + self.beyond if self.forces else p_WE[0]
        way = np.clip(0.033 * (times - 4.0), 0.0, goal - p_WE[0])
        speed = np.where((way > 0) & (way < goal - p_WE[0]), 0.033, 0.0)
        wanted, before = np.zeros(n), 0.0
        for start, force in self.forces.items():
            ramp = 0.5 * (1 - np.cos(np.pi * np.clip(times - start, 0.0, 1.0)))
            wanted, before = wanted + (force - before) * ramp, force
        return {
            "p_WE_d": p_WE + np.outer(way, [1.0, 0.0, 0.0]),
            "q_WE_d": np.tile(q_WE, (n, 1)),
            "v_WE_d": np.outer(speed, [1.0, 0.0, 0.0]),
            **dict.fromkeys(("w_E_d", "a_WE_d", "dw_E_d"), zero),
            "f_ref": wanted[:, None],
            "calibrate": ((times > 1.0) & (times < 3.0)).astype(float)[:, None],
        }


@dataclass(frozen=True)
class Sway:
    """The base at one place, rolling and pitching slowly."""

    model: Model
    p_WB: Array

    def sample(self, times: Array) -> dict[str, Array]:
        robot, zero = self.model.robot, np.zeros((len(times), 3))
        fade = np.clip((times - 2.0) / 4.0, 0.0, 1.0) ** 2
        angles = 0.35 * fade[:, None] * np.column_stack([np.sin(0.5 * times), np.sin(0.35 * times)])
        R_WB = Rotation.from_euler("xy", angles)
        q_WE = (R_WB * Rotation.from_matrix(robot.R_BE)).as_quat(scalar_first=True)
        p_WE = self.p_WB + R_WB.apply(robot.p_BE)
        still = dict.fromkeys(("v_WE_d", "w_E_d", "a_WE_d", "dw_E_d"), zero)
        flags = dict.fromkeys(("f_ref", "calibrate"), zero[:, :1])
        return {"p_WE_d": p_WE, "q_WE_d": q_WE, **still, **flags}


def _fly(
    model: Model,
    duration: float,
    gap: float,
    truth: bool,
    parameters: dict[str, float],
    disturbance: Disturbance | None = None,
    reference: Reference | None = None,
    **more: Any,
) -> Log:
    """From hover with the tip `gap` metres before the wall."""
    plant = Plant(model.robot, "wall", disturbances=[disturbance] if disturbance else [])
    start = plant.base_pose()[:3]
    start[0] = WALL - gap - model.robot.p_BE[0]
    plant.reset(start)
    sensors = SensorsAndSurface(plant, model.robot, seed=0)
    chain = [Controller(block_project(estimators()[n](model, 500.0), model)) for n in ("state_estimator",)]
    law = Controller(block_project(laws()[LAW](model, RATE), model))
    law.set_parameters(parameters)
    at = plant.truth()
    wanted = reference or Approach((at["p_WE"], at["q_WE"]), **more)
    log = Loop(plant, sensors, chain, law, Wiring(wanted, truth)).run(duration, {})
    assert log.fault == ""
    assert set(log.statuses) == {"OK"}
    return log


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def _push(log: Log) -> Array:
    return -log.columns["f_contact_W"][:, 0]


@pytest.mark.parametrize(("truth", "band"), [(True, 1e-3), (False, 8e-3)])
def test_hover(tilting: Model, truth: bool, band: float) -> None:
    log = _fly(tilting, 8.0, 0.6, truth, {})
    after = log.columns["time"][:, 0] > 3.0
    error = (log.columns["p_WE"] - log.columns["p_WE_d"])[after]
    print(f"hover, {'truth' if truth else 'estimates'}: tool RMSE {1e3 * _rms(error):.2f} mm")
    assert _rms(error) < band
    assert np.abs(log.columns["confidence_factor"]).max() == 0.0


@pytest.mark.parametrize("truth", [True, False])
def test_push_of_five_newtons_on_a_wall(tilting: Model, truth: bool) -> None:
    log = _fly(tilting, 16.0, 0.1, truth, {}, forces={8.0: 5.0})
    time, push = log.columns["time"][:, 0], _push(log)
    late = time > 13.0
    tare = log.columns["f_push_B"][late, 0] - push[late]
    slid = np.ptp(log.columns["p_WE"][late], axis=0)[1:]
    print(
        f"push, {'truth' if truth else 'estimates'}: mean {push[late].mean():.2f} N, "
        f"RMSE {_rms(push[late, None] - 5):.2f} N, "
        f"sensor off by {tare.mean():.3f} N, slid {1e3 * slid.max():.1f} mm, peak {push.max():.0f} N"
    )
    assert push[late].mean() == pytest.approx(5.0, abs=0.3)
    assert abs(log.columns["f_push_B"][late, 0].mean() - 5.0) < 0.1
    assert (push[late] > 0).mean() > 0.99
    assert log.columns["confidence_factor"][late].min() > 0.99


def test_steps_settle_and_the_speed_limit_softens_a_missed_approach(tilting: Model) -> None:
    """The set point 40 mm before the wall: with a limit of 5 mm/s at the wall the peak falls far below that without."""
    peaks = {}
    for name, more in (("free", {}), ("limited", {"approach_speed": 0.005})):
        log = _fly(tilting, 18.0, 0.1, True, TUNED | more, beyond=-0.04, forces={8.0: 5.0})
        push, time = _push(log), log.columns["time"][:, 0]
        assert push[time > 16.0].mean() == pytest.approx(5.0, abs=0.3)
        peaks[name] = push.max()
    print(f"peak with the set point 40 mm before the wall: {peaks['free']:.0f} N, limited {peaks['limited']:.1f} N")
    assert peaks["free"] > 60.0
    assert peaks["limited"] < 20.0


def test_no_force_where_the_wall_is_far(tilting: Model) -> None:
    """Set point 0.5 m before the wall, beyond d_max: force is wanted and none is tried."""
    log = _fly(tilting, 12.0, 0.55, True, {}, beyond=-0.5, forces={7.0: 5.0})
    assert np.abs(log.columns["f_dir_B"]).max() == 0.0
    assert _push(log).max() == 0.0
    assert _rms((log.columns["p_WE"] - log.columns["p_WE_d"])[-2000:]) < 2e-3


def test_stiffness_at_the_wall_is_that_of_7_for_every_row_of_table_5(tilting: Model) -> None:
    """A pull of 3 N away from a wall that is seen moves the tool by f / (K m), m = 1 for PD, m_free in the air."""
    near = {"d_min": 0.5, "d_max": 0.6, "K_I_lin": 3.0}
    rows = {
        "stick, 5": ({"d_min": 0.0, "d_max": 0.05}, 5.0),
        "pd": ({**near, "m_wall": 1.0, "m_free": 1.0, "J_v": 1.0}, 1.0),
        "wall, 0.5": ({**near, "m_wall": 0.5}, 0.5),
        "wall, 0.25": ({**near, "m_wall": 0.25}, 0.25),
    }
    for name, (parameters, multiplier) in rows.items():
        log = _fly(tilting, 10.0, 0.2, True, parameters, disturbance=ToolForce((-3.0, 0.0, 0.0), 1.0, 30.0, ramp=1.0))
        moved = (log.columns["p_WE"] - log.columns["p_WE_d"])[-1000:, 0].mean()
        print(f"{name}: stiffness {3.0 / -moved:.1f} N/m")
        assert 3.0 / -moved == pytest.approx(100.0 * multiplier, rel=0.03)


def test_centre_of_mass_is_found_in_flight(tilting: Model) -> None:
    """(27)-(29): five millimetres injected into the plant, found to one from measured thrusts and tilts alone."""
    offset = np.array([0.003, -0.0025, 0.0031])
    assert np.linalg.norm(offset) == pytest.approx(5e-3, rel=0.01)
    start = np.array([WALL - 0.6 - tilting.robot.p_BE[0], 0.0, 1.5])
    flight = CentreOfMassError(tuple(offset)), Sway(tilting, start)
    columns = _fly(tilting, 40.0, 0.6, False, {"m_wall": 5.0}, *flight).columns
    every = slice(6000, None, 10)
    thrust, tilt = (ca.DM(columns[f"{name}_measured_est"][every].T) for name in ("thrust", "tilt"))
    T, a = ca.SX.sym("T", tilting.rotors), ca.SX.sym("a", tilting.tilts)
    f_B, tau_C = ca.Function("wrench", [T, a], list(tilting.rotor_wrench(T, a))).map(thrust.shape[1])(thrust, tilt)
    found = centre_of_mass(f_B.full().T, tau_C.full().T)
    print(f"centre of mass: {1e3 * found} mm found of {1e3 * offset} mm")
    assert np.linalg.norm(found - offset) < 1e-3
