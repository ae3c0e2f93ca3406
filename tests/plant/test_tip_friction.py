"""Tip friction: the exact step, dissipation, and the tip sliding on a table and on a wall."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hand import Hand

from aerotact.plant.plant import Plant
from aerotact.plant.tip_friction import DAMPING, STIFFNESS, lugre_step
from aerotact.robot import Robot

X = np.array([1.0, 0.0, 0.0])


def test_step_is_exact_for_a_constant_velocity() -> None:
    """One step of 10 ms gives the deflection of 1000 steps of 10 us."""
    v = np.array([2e-3, -1e-3, 0.0])
    coarse, _ = lugre_step(np.array([1e-5, 2e-5, 0.0]), v, 5.0, 0.4, 0.01)
    fine = np.array([1e-5, 2e-5, 0.0])
    for _ in range(1000):
        fine, _ = lugre_step(fine, v, 5.0, 0.4, 1e-5)
    np.testing.assert_allclose(coarse, fine, rtol=1e-11, atol=1e-18)


@pytest.mark.parametrize("speed", [1e-3, 0.1, 5.0])
def test_steady_sliding_has_coulombs_force(speed: float) -> None:
    z = np.zeros(3)
    for _ in range(2000):
        z, force = lugre_step(z, speed * X, 7.0, 0.3, 1e-3)
    np.testing.assert_allclose(force, -0.3 * 7.0 * X, rtol=1e-9)
    np.testing.assert_allclose(z, 0.3 / STIFFNESS * X, rtol=1e-9)


def test_small_motion_is_a_spring() -> None:
    z, force = lugre_step(np.zeros(3), 1e-6 / 1e-3 * X, 10.0, 0.5, 1e-3)
    np.testing.assert_allclose(z, 1e-6 * X, rtol=1e-2)
    np.testing.assert_allclose(force, -10.0 * (STIFFNESS * 1e-6 + DAMPING * 1e-3) * X, rtol=1e-2)


@pytest.mark.parametrize("velocity", [0.0, 1e-300, 1e-12, 1e3])
def test_extreme_speeds_stay_finite_and_in_the_disc(velocity: float) -> None:
    z, force = lugre_step(np.array([5e-5, 0.0, 0.0]), velocity * X, 1e4, 0.5, 1e-3)
    assert np.isfinite(z).all()
    assert np.linalg.norm(force) <= 0.5 * 1e4 * (1 + 1e-12)
    assert np.linalg.norm(z) <= 0.5 / STIFFNESS * (1 + 1e-12)


def test_no_friction_no_force() -> None:
    z, force = lugre_step(np.array([1e-5, 0.0, 0.0]), X, 10.0, 0.0, 1e-3)
    np.testing.assert_array_equal(z, 0.0)
    np.testing.assert_array_equal(force, 0.0)


def test_friction_dissipates() -> None:
    """Work taken from the tip never falls short of the energy in the bristles, whatever the motion."""
    rng = np.random.default_rng(3)
    normal_force, mu, dt = 6.0, 0.5, 1e-3
    z, v, work = np.zeros(3), np.zeros(3), 0.0
    balance = []
    for _ in range(20000):
        v = 0.98 * v + 2e-3 * np.append(rng.normal(size=2), 0.0)
        z, force = lugre_step(z, v, normal_force, mu, dt)
        work -= force @ v * dt
        balance.append(work - 0.5 * STIFFNESS * normal_force * z @ z)
    assert min(balance) > -1e-12
    assert balance[-1] > 0.05


@pytest.mark.parametrize("amplitude", [1e-3, 1e-2])
def test_a_cycle_costs_coulombs_work(amplitude: float) -> None:
    """Far beyond the bristles' reach (mu / sigma0 = 0.1 mm) a cycle costs 4 A mu N less the turning."""
    normal_force, mu, dt = 4.0, 0.5, 1e-4
    times = np.arange(0.0, 3.0, dt)
    velocity = amplitude * 2 * np.pi * np.cos(2 * np.pi * times)
    z, work = np.zeros(3), np.zeros(times.size)
    for i, v in enumerate(velocity):
        z, force = lugre_step(z, v * X, normal_force, mu, dt)
        work[i] = -force[0] * v * dt
    a_cycle = work[times >= 1.0].sum() / 2
    most = 4 * amplitude * mu * normal_force
    assert most * (1 - 3 * mu / STIFFNESS / amplitude) < a_cycle < most


CASES = {
    # robot, world, base position that touches, direction of pressing, direction of sliding, friction of the surface
    "table": ("tilt_hex", [0.0, 0.0, 1.2], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], 0.4),
    "wall": ("octorotor", [0.29, 0.0, 1.2], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0.5),
}


@pytest.mark.parametrize("world", CASES)
def test_tip_slides_without_hopping(world: str, tilt_hex: Robot, octorotor: Robot) -> None:
    name, start, press, glide, mu = CASES[world]
    robot = {"tilt_hex": tilt_hex, "octorotor": octorotor}[name]
    press_W, glide_W = 5.0 * np.array(press), np.array(glide)
    plant = Plant(robot, world, disturbances=[Hand(press_W, 0.1 * glide_W, 0.4)])
    plant.reset(p_WB=start)
    forces, speeds = [], []
    for _ in range(1600):
        plant.step()
        truth = plant.truth()
        forces.append(truth["f_contact_W"])
        speeds.append(truth["v_WE"])
    normal = -np.array(forces) @ np.array(press)
    along = np.array(forces) @ glide_W
    sliding = slice(900, None)
    assert normal[100:].min() > 1.0, "airborne"
    np.testing.assert_allclose(normal[sliding], normal[sliding].mean(), rtol=0.02)
    assert normal[sliding].mean() == pytest.approx(5.0, rel=0.1), "the hand gives way and the weight leans a little"
    np.testing.assert_allclose(np.array(speeds)[sliding] @ glide_W, 0.1, rtol=0.02)
    np.testing.assert_allclose(-along[sliding] / normal[sliding], mu, rtol=0.02)
    across = np.cross(press, glide_W)
    assert np.abs(np.array(forces)[sliding] @ across).max() < 0.02
    assert np.abs(np.diff(normal[sliding])).max() < 0.01


def test_plate_on_a_slide_is_dragged_along_until_it_moves_with_the_tip(octorotor: Robot, tmp_path: Path) -> None:
    """Friction acts on both: the plate gains what the tip loses, mu N / m, until it sticks to the tip."""
    file = tmp_path / "plate.xml"
    file.write_text(
        '<mujoco><worldbody><body name="plate" pos="1.05 0 1.2" gravcomp="1">'
        '<joint name="rail" type="slide" axis="0 1 0"/>'
        '<geom name="surface" type="box" size="0.05 0.5 0.5" mass="8" contype="1" conaffinity="1" condim="1" '
        'friction="0.5"/></body></worldbody></mujoco>'
    )
    y = np.array([0.0, 1.0, 0.0])
    plant = Plant(octorotor, file, disturbances=[Hand(np.array([5.0, 0, 0]), 0.3 * y, 0.4)])
    plant.reset(p_WB=[0.29, 0.0, 1.2])
    forces, speeds, tips = [], [], []
    for _ in range(2500):
        plant.step()
        truth = plant.truth()
        forces.append(truth["f_contact_W"])
        speeds.append(plant.data.joint("rail").qvel[0])
        tips.append(truth["v_WE"][1])
    impulse = -np.array(forces)[:, 1].sum() * plant.timestep
    assert 8.0 * speeds[-1] == pytest.approx(impulse, rel=1e-9)
    assert speeds[-1] == pytest.approx(tips[-1], abs=1e-3)
    assert speeds[-1] > 0.25
    slipping = np.array(tips) - np.array(speeds) > 0.02
    assert slipping.sum() > 100
    friction, normal = -np.array(forces)[slipping, 1], -np.array(forces)[slipping, 0]
    np.testing.assert_allclose(friction[20:], 0.5 * normal[20:], rtol=0.02)
    assert np.abs(np.array(forces)[-200:, 1]).max() < 0.5 * normal.min(), "inside the cone"


def test_tip_sticks_within_the_cone(tilt_hex: Robot) -> None:
    """1.5 N across 5 N with mu = 0.4: the tip stays, and friction holds the force."""

    class Pull:
        def begin(self, plant: Plant) -> None:
            pass

        def apply(self, plant: Plant) -> None:
            if plant.time > 0.5:
                plant.push(plant.base_id, np.array([1.5, 0.0, 0.0]), plant.data.site_xpos[plant.tip.site])

    plant = Plant(tilt_hex, "table", disturbances=[Hand(np.array([0.0, 0.0, -5.0]), np.zeros(3), 0.0, 0.0), Pull()])
    plant.reset(p_WB=[0.0, 0.0, 1.2])
    tip = []
    for _ in range(2000):
        plant.step()
        tip.append(plant.truth()["p_WE"])
    force = plant.truth()["f_contact_W"]
    axes_B = np.array([rotor.axis_B for rotor in tilt_hex.rotors])
    lift_W = plant.data.xmat[plant.base_id].reshape(3, 3) @ (axes_B.T @ plant.truth()["thrust"])
    weight_W = np.array([0.0, 0.0, -tilt_hex.mass * tilt_hex.gravity])
    np.testing.assert_allclose(force, -(lift_W + weight_W + [1.5, 0.0, -5.0]), atol=1e-3)
    assert 1.3 < -force[0] < 1.6
    assert np.linalg.norm(tip[-1] - tip[1000]) < 50e-6


def test_contact_force_agrees_with_the_force_sensor(tilt_hex: Robot) -> None:
    """The sensor reads in E the force of the tool on the table; it knows nothing of how the truth is made."""
    plant = Plant(tilt_hex, "table", disturbances=[Hand(np.array([0.0, 0.0, -5.0]), 0.1 * X, 0.2)])
    plant.reset(p_WB=[0.0, 0.0, 1.2])
    adr = plant.model.sensor("tip_force").adr[0]
    for n in range(1000):
        R_WE = plant.data.site_xmat[plant.tip.site].reshape(3, 3).copy()
        plant.step()
        if n > 100:
            measured = -R_WE @ plant.data.sensordata[adr : adr + 3]
            np.testing.assert_allclose(measured, plant.truth()["f_contact_W"], atol=1e-6)
    assert plant.truth()["f_contact_W"][2] > 4.0


def test_leaving_the_surface_ends_the_force(tilt_hex: Robot) -> None:
    plant = Plant(tilt_hex, "table")
    plant.reset(p_WB=[0.0, 0.0, 1.2 - 2e-5])
    plant.step()
    assert plant.truth()["f_contact_W"][2] > 0.0
    for _ in range(200):
        plant.step()
    truth = plant.truth()
    assert truth["p_WE"][2] > 0.8
    np.testing.assert_array_equal(truth["f_contact_W"], 0.0)
    np.testing.assert_array_equal(truth["f_tool_W"], 0.0)
    assert plant.tip.friction.bristles == {}
    np.testing.assert_array_equal(plant.data.xfrc_applied, 0.0)


def test_reset_forgets_contact(tilt_hex: Robot) -> None:
    plant = Plant(tilt_hex, "table", disturbances=[Hand(np.array([0.0, 0.0, -5.0]), 0.1 * X, 0.0)])
    plant.reset(p_WB=[0.0, 0.0, 1.2])
    for _ in range(300):
        plant.step()
    assert plant.tip.friction.bristles
    plant.reset()
    assert plant.tip.friction.bristles == {}
    np.testing.assert_array_equal(plant.truth()["f_contact_W"], 0.0)
    mujoco.mj_forward(plant.model, plant.data)
    np.testing.assert_allclose(plant.data.qacc, 0.0, atol=1e-12)
