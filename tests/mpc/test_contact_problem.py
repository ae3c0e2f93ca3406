"""The force problem of tilting rotors: hover, push, approach, and a delay that is predicted; momentum balances."""

import casadi as ca
import numpy as np
import pytest
from inspection import Inspected
from stepping import rotation

from aerotact.controller import Status
from aerotact.dynamics.contact import contact_motion
from aerotact.dynamics.model import Model
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.mpc.prediction import surface, wrench
from aerotact.ports import Array

N_W = np.array([-1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def ocp(tilting: Model) -> Ocp:
    return load_ocp("tilt_rotor_force", tilting)


@pytest.fixture
def mpc(ocp: Ocp) -> Inspected:
    made = Inspected(ocp)
    made.hover(ocp)
    made.measurement["n_W"][:] = N_W
    made.measurement["surface_distance"][:] = 0.5
    made.measurement["surface_valid"][:] = 1.0
    made.measurement["friction"][:] = 0.4
    return made


def _rotor_force_W(ocp: Ocp, x: Array) -> Array:
    s = ocp.model.state.unpack(x)
    f_B, _ = ocp.model.rotor_wrench(ca.DM(s["thrust"]), ca.DM(s["tilt"]))
    return rotation(s["q_WB"]) @ f_B.full().ravel()


def test_hover_is_kept(ocp: Ocp, mpc: Inspected) -> None:
    for _ in range(3):
        assert mpc.step() is Status.OK
    np.testing.assert_allclose(mpc.output["thrust_cmd"], ocp.model.robot.hover_thrust, atol=1e-3)
    np.testing.assert_allclose(mpc.output["tilt_cmd"], ocp.model.robot.hover_tilt, atol=1e-4)
    assert mpc.output["pushing"] == mpc.output["approaching"] == 0


def test_a_push_ends_with_the_rotors_force_on_the_wall(ocp: Ocp, mpc: Inspected) -> None:
    mpc.measurement["surface_distance"][:] = 0.0
    mpc.measurement["contact"][:] = 1.0
    mpc.measurement["normal_force"][:] = 0.5
    mpc.reference["f_ref"][:] = 5.0
    mpc.configure(startup_iterations=1)
    for k in range(60):  # periods at the same place: the force wanted rises at its rate, and the wall takes it
        # A cold start in contact is far from its plan: there, full steps may end a programme early.
        assert mpc.step() in ((Status.OK, Status.MAX_ITERATIONS) if k < 3 else (Status.OK,))
        mpc.measurement["normal_force"][:] = mpc.output["f_push"]
    assert mpc.output["pushing"] == 1
    assert mpc.output["f_push"] == pytest.approx(5.0)
    x = mpc.fields["plan_x"]
    # at the end of the horizon the robot is at rest: what its rotors give beyond its weight is what the wall takes
    balance = _rotor_force_W(ocp, x[-1]) - [0.0, 0.0, ocp.model.robot.mass * ocp.model.robot.gravity]
    assert balance @ -N_W == pytest.approx(5.0, abs=0.1)
    assert np.abs(x[:, :3] - x[0, :3]).max() < 5e-3
    stage = ocp.targets.stage.split(ca.DM(mpc.fields["stage"][5]))
    moved = contact_motion(ocp.model, ca.DM(x[5]), wrench(stage), surface(stage))
    assert float(moved.force) == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("distance", [0.15, 0.02])
def test_the_approach_is_planned_within_its_speed(ocp: Ocp, mpc: Inspected, distance: float) -> None:
    mpc.measurement["surface_distance"][:] = distance
    mpc.reference["f_ref"][:] = 5.0
    mpc.reference["p_WE_d"][:, 0] += distance + 0.04  # behind the wall
    mpc.configure(startup_iterations=40)
    assert mpc.step() is Status.OK
    assert mpc.output["approaching"] == 1
    tip, speed = [], []
    for row in mpc.fields["plan_x"]:
        tip.append(float(ocp.model.tool_pose(ca.DM(row))[0][0]))
        speed.append(float(ocp.model.tool_twist(ca.DM(row))[0][0]))
    gap = distance - (np.array(tip) - tip[0])
    margin = ocp.parameters.unpack(ocp.parameters.default)["approach_margin"]
    allowed = 0.004 + margin + np.maximum(gap, 0.0)
    assert (np.array(speed) < allowed + 1e-3).all()
    assert gap[-1] < 0.9 * distance
    assert gap.min() > -2e-3


def test_a_delay_is_predicted(ocp: Ocp, tilting: Model) -> None:
    late = load_ocp("tilt_rotor_force", tilting, 0.008)  # rounded up to two periods
    assert late.file.problem.delay == pytest.approx(0.01)
    x = ca.DM(tilting.hover_state)
    y = late.targets.block.measurement.default
    layout, v = late.targets.block.measurement, np.array([0.3, -0.2, 0.1])
    hover = tilting.state.unpack(tilting.hover_state)
    values = {**{p.name: hover[p.name] for p in layout if p.name in hover}, "v_WB": v, "surface_distance": 1.0}
    y = layout.pack({**values, "surface_valid": 1.0, "n_W": N_W})
    block = late.targets.block
    _, out = block.step(block.state.default, y, block.reference.default, block.parameters.default)
    x0 = out.full().ravel()[: tilting.state.size]
    # under the thrust of hover nothing accelerates: two periods further along the velocity
    np.testing.assert_allclose(x0[:3], np.array(x)[:3, 0] + 0.01 * v, atol=1e-9)
    np.testing.assert_allclose(x0[13:], np.array(x)[13:, 0], atol=1e-12)
