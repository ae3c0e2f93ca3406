"""The contact observer: what is contact, what is friction and what is disturbance, from readings made by hand."""

import casadi as ca
import numpy as np
import pytest
from stepping import rotation

from aerotact.dynamics.contact import Surface, contact_motion
from aerotact.dynamics.model import Model
from aerotact.estimation.contact_observer import contact_observer
from aerotact.exceptions import MissingCapability
from aerotact.ports import Array

RATE = 500.0
N_W = np.array([-1.0, 0.0, 0.0])  # of a wall ahead of the level robot, whose tool looks along x


class Observed:
    """The block, fed with a robot at rest in hover whose tool feels what it is told."""

    def __init__(self, model: Model) -> None:
        self.block = contact_observer(model, RATE)
        self.model, self.z = model, self.block.state.default
        sensor = model.robot.force_torque
        assert sensor is not None
        self._sensor = sensor

    def step(self, f_tool_W: Array, **measured: Array | float) -> dict[str, Array]:
        """One step; `f_tool_W` is the force of the environment on the tip, `measured` replaces what hover gives."""
        sensor, robot = self._sensor, self.model.robot
        hover = self.model.state.unpack(self.model.hover_state)
        up_B = rotation(np.asarray(measured.get("q_WB", hover["q_WB"]))).T
        weight_B, f_tool_B = up_B @ [0.0, 0.0, sensor.distal_mass * robot.gravity], up_B @ f_tool_W
        f_S = sensor.R_BS.T @ (weight_B - f_tool_B)
        tau_S = np.cross(sensor.p_SD, sensor.R_BS.T @ weight_B)
        tau_S -= sensor.R_BS.T @ np.cross(robot.p_BE - sensor.p_BS, f_tool_B)
        # the robot does not move, whatever the tool feels: an accelerometer at rest
        values = {
            **{name: hover[name] for name in ("p_WB", "q_WB", "v_WB", "w_B")},
            "thrust_measured": hover["thrust"],
            "tilt_measured": hover["tilt"],
            "specific_force_B": up_B @ [0.0, 0.0, robot.gravity],
            "f_sensor_S": f_S,
            "tau_sensor_S": tau_S,
            "n_W": N_W,
            "surface_distance": 0.0,
            "surface_valid": 1.0,
            **measured,
        }
        y = self.block.measurement.pack(values)
        z, u = self.block.step(self.z, y, self.block.reference.default, self.block.parameters.default)
        self.z = z.full().ravel()
        return self.block.output.unpack(u.full().ravel())

    def run(self, seconds: float, f_tool_W: Array, **measured: Array | float) -> dict[str, Array]:
        for _ in range(round(seconds * RATE)):
            out = self.step(f_tool_W, **measured)
        return out


@pytest.fixture
def observed(tilting: Model) -> Observed:
    return Observed(tilting)


def test_contact_begins_with_a_force_near_a_surface_and_only_there(observed: Observed) -> None:
    assert observed.run(0.5, 0.5 * N_W)["contact"] == 0  # too weak
    assert observed.run(0.5, 2.0 * N_W, surface_distance=0.05)["contact"] == 0  # too far
    assert observed.run(0.5, 2.0 * N_W, surface_valid=0.0)["contact"] == 0  # nothing seen
    assert observed.run(0.1, 2.0 * N_W)["contact"] == 1
    assert observed.run(0.5, 2.0 * N_W)["normal_force"] == pytest.approx(2.0, abs=1e-6)


def test_contact_outlives_a_short_loss_and_no_long_one(observed: Observed) -> None:
    observed.run(0.3, 2.0 * N_W)
    assert observed.run(0.15, 0.0 * N_W)["contact"] == 1
    assert observed.run(0.2, 2.0 * N_W)["contact"] == 1
    assert observed.run(0.4, 0.0 * N_W)["contact"] == 0


def test_a_drifting_sensor_holds_no_contact_with_a_surface_far_away(observed: Observed) -> None:
    drift = 0.3 * N_W  # more than lost_force
    observed.run(0.3, 2.0 * N_W)
    assert observed.run(0.5, drift)["contact"] == 1
    assert observed.run(0.15, drift, surface_distance=0.05)["contact"] == 1
    assert observed.run(0.5, drift, surface_valid=0.0)["contact"] == 1  # unseen: the force alone tells
    assert observed.run(0.25, drift, surface_distance=0.05)["contact"] == 0


def test_the_tools_force_is_no_disturbance_in_contact_and_one_away_from_it(observed: Observed) -> None:
    """At rest under hover thrust with 5 N at the tool, something else must push with -5 N."""
    push = 5.0 * N_W
    held = observed.run(1.5, push)
    np.testing.assert_allclose(held["f_dist_W"], -push, atol=1e-3)
    away = Observed(observed.model).run(1.5, push, surface_distance=1.0)
    np.testing.assert_allclose(away["f_dist_W"], 0.0, atol=1e-3)
    np.testing.assert_allclose(away["tau_dist_B"], 0.0, atol=1e-3)


def test_along_the_normal_the_disturbance_is_found_faster_in_contact(observed: Observed) -> None:
    observed.run(1.5, 5.0 * N_W)
    share = 1 - observed.run(0.02, 6.0 * N_W)["f_dist_W"][0] / 5.0
    assert share == pytest.approx(-(1 - np.exp(-100 * 0.02)) / 5, rel=0.05)  # 100 rad/s, not 40
    observed.run(1.5, 5.0 * N_W)
    across = observed.run(0.02, 5.0 * N_W + [0.0, 1.0, 0.0])["f_dist_W"][1]
    assert across == pytest.approx(-(1 - np.exp(-40 * 0.02)), rel=0.05)


@pytest.mark.parametrize("mu", [0.2, 0.7])
def test_friction_follows_what_the_sliding_tip_feels_and_rests_with_it(observed: Observed, mu: float) -> None:
    start = observed.run(0.5, 5.0 * N_W)["friction"]
    assert start == pytest.approx(0.4)  # at rest nothing is learnt
    sliding = {"v_WB": np.array([0.0, 0.1, 0.0])}
    felt = 5.0 * N_W + np.array([0.0, -5.0 * mu, 0.0])
    assert observed.run(2.5, felt, **sliding)["friction"] == pytest.approx(mu, abs=2e-3)


def test_a_robot_without_the_sensor_is_refused(hexarotor: Model) -> None:
    with pytest.raises(MissingCapability, match="force_torque"):
        contact_observer(hexarotor, RATE)


@pytest.mark.parametrize("pitch", [0.0, 0.5])
def test_the_predictor_finds_the_force_that_is_felt(tilting: Model, pitch: float) -> None:
    """Whatever the pose, and whatever turns the robot: what the observer calls disturbance explains the reading."""
    q_WB = np.array([np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0])
    hover = tilting.state.unpack(tilting.hover_state)
    thrust = hover["thrust"] * [1.1, 0.9, 1.0, 1.2, 0.8, 1.0]
    observed, push = Observed(tilting), 8.0 * N_W
    out = observed.run(1.5, push, q_WB=q_WB, thrust_measured=thrust)
    x = tilting.state.pack({**hover, "q_WB": q_WB, "thrust": thrust})
    rest = ca.vertcat(ca.DM(out["f_dist_W"]), ca.DM(out["tau_dist_B"]))
    surface = Surface(ca.DM(N_W), 0.0, ca.DM.zeros(3), 2000.0, 150.0, 1.0)
    # the torque observer takes the robot for one that does not turn, as the readings say
    assert float(contact_motion(tilting, ca.DM(x), rest, surface).force) == pytest.approx(8.0, abs=1e-3)


def test_a_strike_is_no_disturbance(observed: Observed) -> None:
    """A tip that is thrown back feels much and rests not: only after a while of unbroken force is it taken to rest."""
    observed.run(0.5, 0.0 * N_W)
    for _ in range(3):  # 6 ms at 20 N, which the accelerometer explains
        felt = 20.0 * N_W
        up = np.array([0.0, 0.0, observed.model.robot.gravity])
        struck = observed.step(felt, specific_force_B=up + felt / observed.model.robot.mass)
    assert struck["contact"] == 1
    assert np.abs(struck["f_dist_W"]).max() < 0.1
