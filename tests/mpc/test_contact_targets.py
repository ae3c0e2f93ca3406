"""Targets of contact: friction opposes the sliding wanted, the push keeps near the force felt, the approach is free."""

import casadi as ca
import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.mpc.contact_targets import LEAD
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Array

N_W = np.array([-1.0, 0.0, 0.0])
MU = 0.3


@pytest.fixture(scope="module")
def ocp(tilting: Model) -> Ocp:
    return load_ocp("tilt_rotor_force", tilting)


class Told:
    """The block of targets at a wall, stepped by hand."""

    def __init__(self, ocp: Ocp) -> None:
        self.ocp, self.block, self.z = ocp, ocp.targets.block, ocp.targets.block.state.default
        hover = ocp.model.state.unpack(ocp.model.hover_state)
        self.at_wall = {p.name: hover[p.name] for p in self.block.measurement if p.name in hover}
        self.at_wall |= {"n_W": N_W, "surface_valid": 1.0, "friction": MU}

    def step(
        self, sliding: Array | None = None, f_ref: float = 5.0, **measured: Array | float
    ) -> list[dict[str, Array]]:
        """Stage parameters of every node; `sliding` is the velocity wanted, m/s."""
        nodes = len(self.ocp.times)
        wanted = {"f_ref": np.full(nodes, f_ref)}
        if sliding is not None:
            wanted["v_WE_d"] = np.tile(sliding, (nodes, 1))
        y = self.block.measurement.pack({**self.at_wall, **measured})
        r = self.block.reference.pack(wanted)
        z, out = self.block.step(self.z, y, r, self.block.parameters.default)
        self.z = z.full().ravel()
        stages = self.block.output.unpack(out.full().ravel())["stage"]
        return [self.ocp.targets.stage.unpack(row) for row in stages]

    def run(self, seconds: float, **given: Array | float) -> list[dict[str, Array]]:
        for _ in range(round(seconds * self.block.rate)):
            stages = self.step(**given)  # type: ignore[arg-type]
        return stages


def test_friction_opposes_the_sliding_wanted(ocp: Ocp) -> None:
    v = np.array([0.05, 0.3, -0.4])  # its part along the normal is no sliding
    for stage in Told(ocp).step(sliding=v, contact=1.0, normal_force=5.0):
        expected = -MU * np.array([0.0, 0.6, -0.8])
        np.testing.assert_allclose(stage["friction_W"], expected, atol=3e-3 * MU)


def test_a_tip_that_rests_keeps_the_friction_felt_within_the_coefficient(ocp: Ocp) -> None:
    for share, kept in ((0.2, 0.2), (0.9, MU)):
        f_tip = 5.0 * N_W + np.array([0.0, 0.0, 5.0 * share])
        stages = Told(ocp).run(0.5, contact=1.0, normal_force=5.0, f_tip_W=f_tip)
        np.testing.assert_allclose(stages[0]["friction_W"], [0.0, 0.0, kept], atol=1e-4)
        np.testing.assert_allclose(stages[-1]["friction_W"], stages[0]["friction_W"])


def test_no_contact_is_predicted_on_the_way_to_the_surface(ocp: Ocp) -> None:
    away, there = Told(ocp).step(surface_distance=0.01), Told(ocp).step(contact=1.0, normal_force=1.0)
    assert all(s["approach"] == 1 and s["stiffness"] == 0 and s["damping"] == 0 for s in away)
    assert all(s["push"] == 1 and s["rigid"] == 1 and s["stiffness"] > 0 for s in there)


def test_the_limit_of_the_approach_leaves_room_above_its_speed(ocp: Ocp) -> None:
    stage = Told(ocp).step(surface_distance=0.01)[0]
    limit = stage["approach_speed"] + stage["approach_slope"] * 0.01
    np.testing.assert_allclose(limit, stage["v_approach"] + 0.004)


def test_the_force_wanted_keeps_near_the_force_felt(ocp: Ocp) -> None:
    told = Told(ocp)
    preload = told.block.parameters["preload"].default[0]
    for felt in (0.0, 1.0):
        pushes = [s["f_push"].item() for s in told.run(0.3, contact=1.0, normal_force=felt)]
        assert max(pushes) == pytest.approx(preload + LEAD * felt)
    assert told.run(0.3, contact=1.0, normal_force=5.0)[0]["f_push"].item() == pytest.approx(5.0)


def test_friction_enters_the_thrust_that_holds_the_push(ocp: Ocp) -> None:
    stage = Told(ocp).run(0.5, f_ref=2.0, contact=1.0, normal_force=2.0, sliding=np.array([0.0, 0.5, 0.0]))[-1]
    thrust, tilt = ca.DM(stage["thrust_trim"]), ca.DM(stage["tilt_trim"])
    f_B, _ = ocp.model.rotor_wrench(thrust, tilt)
    weight = ocp.model.robot.mass * ocp.model.robot.gravity
    np.testing.assert_allclose(f_B.full().ravel(), [2.0, 2.0 * MU, weight], atol=0.02)
