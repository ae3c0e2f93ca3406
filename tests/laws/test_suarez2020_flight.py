"""The platform's laws of suarez2020 as generated C, flown in MuJoCo on simulated sensors."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from aerotact.dynamics import so3
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.experiments.experiment import Case, ControllerSpec, Experiment
from aerotact.experiments.suarez2020.controllers import PID
from aerotact.experiments.suarez2020.hover import Hover
from aerotact.experiments.suarez2020.hover_grasp import HoverGrasp
from aerotact.experiments.suarez2020.reaction_wrenches import PUSH, ReactionWrenches
from aerotact.experiments.suarez2020.stop import StopFromFlight
from aerotact.experiments.suarez2020.swing_release import SwingRelease
from aerotact.flight import fly
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.robot import load_robot

NESTED = ControllerSpec(
    "suarez2020_position", 50.0, "", inner=ControllerSpec("suarez2020_attitude", 250.0, "attitude and rate only")
)


def _fly(
    experiment: Experiment, case: str, label: str = "law", seed: int = 0, end: float | None = None
) -> tuple[Log, dict[str, Metric]]:
    chosen = next(c for c in experiment.cases if c.name == case)
    if end is not None:
        chosen = replace(chosen, duration=end, judged=(chosen.judged[0], end))
    log, result = fly(experiment, chosen, label, seed)
    assert result.fault == ""
    assert set(log.statuses) == {"OK"}
    for limit in ("thrust", "thrust_rate"):
        assert result.metrics[f"violations_{limit}"].value == 0
    return log, result.metrics


@pytest.mark.parametrize("case", ["standard", "long-reach"])
@pytest.mark.parametrize("spec", [None, NESTED], ids=["one block", "nested"])
def test_hover_on_simulated_sensors(case: str, spec: ControllerSpec | None) -> None:
    experiment = Hover(controllers={"law": spec}) if spec else Hover()
    _, found = _fly(experiment, case, end=12.0)
    print(case, {name: metric.value for name, metric in found.items() if name.endswith(case)})
    assert found[f"base_max_{case}"].value < 8e-3  # type: ignore[operator]
    assert found[f"tilt_max_{case}"].value < 0.02  # type: ignore[operator]


@pytest.mark.parametrize("case", ["backward", "forward"])
def test_swing_is_below_a_tenth_within_two_seconds_with_swing_feedback(case: str) -> None:
    """The done-when of the long reach; without feedback it takes longer, with the attitude held it does not end."""
    times = {label: _fly(SwingRelease(), case, label)[1]["below_10"].value for label in ("attitude-hold", "pid", "law")}
    print(case, times)
    assert times["law"] < 2.0 < times["pid"] < times["attitude-hold"]  # type: ignore[operator]
    assert times["attitude-hold"] > 6.0  # type: ignore[operator]


def test_feedback_of_the_swing_shortens_it_after_a_stop() -> None:
    """And the sign matters: the other one makes the pendulum worse than none."""
    experiment = StopFromFlight()
    wrong = replace(PID, parameters={**PID.parameters, "K_swing": -0.15})
    experiment = replace(experiment, controllers={**experiment.controllers, "wrong": wrong})
    times = {label: _fly(experiment, "stop", label)[1]["below_2deg"].value for label in ("law", "pid", "wrong")}
    print("stop, below 2 degrees after", times)
    assert times["law"] < times["pid"] < times["wrong"]  # type: ignore[operator]


@pytest.mark.parametrize("case", ["standard-up", "long-reach-forward"])
def test_torque_at_the_platform_is_that_of_statics(case: str) -> None:
    """Rotors, weights and the push balance about the base's origin in the posture that was flown (Fig. 33), and

    deflection times stiffness is the torque of gravity and contact within 5 %.
    """
    experiment = ReactionWrenches()
    log, found = _fly(experiment, case)
    model = model_of(load_robot(str(next(c for c in experiment.cases if c.name == case).robot)))
    assert isinstance(model, Multibody)
    rows = log.window(15.0, 19.0)
    mean = {n: log[n][rows].mean(axis=0) for n in ("p_WB", "q_WB", "joint", "servo", "thrust")}
    x = model.state.pack({**mean, "v_WB": np.zeros(3), "w_B": np.zeros(3), "joint_rate": np.zeros(model.joints)})
    push = np.array([0.0, 0.0, -PUSH] if case.endswith("up") else [-PUSH, 0.0, 0.0])
    p = model.disturbance.pack({"f_left_W": push})
    R_WB = so3.rotation(ca.DM(mean["q_WB"]))
    up_B = (R_WB[2, :].T * model.robot.gravity).full().ravel()
    load = ca.DM(model.tool_force_torques(ca.DM(x), ca.DM(p))).full().ravel()
    weight = ca.DM(model.bodies.mass_matrix(ca.DM(mean["joint"]))).full()[:, :3] @ up_B
    torque = ca.DM(model.rotor_wrench(ca.DM(mean["thrust"]))[1]).full().ravel()
    print(
        case, "torque of the rotors", torque, "of weight and push", (weight - load)[3:6], found[f"pitch_{case}"].value
    )
    np.testing.assert_allclose(torque, (weight - load)[3:6], atol=0.02)

    spring = (mean["servo"] - mean["joint"][model.passive :]) * model.stiffness
    asked = (weight - load)[6 + model.passive :]
    loaded = np.abs(asked) > 0.1
    assert loaded.sum() >= 2
    np.testing.assert_allclose(spring[loaded], asked[loaded], rtol=0.05)
    if case == "standard-up":
        assert found[f"pitch_{case}"].value > 0.2  # type: ignore[operator]  # nose down, in front of the base
        assert found[f"roll_{case}"].value == pytest.approx(-0.3, abs=0.05)
        assert found[f"axial_{case}"].value == pytest.approx(-2.0, abs=0.05)
    else:
        assert abs(found[f"pitch_{case}"].value) < 0.2  # type: ignore[arg-type]
        assert found[f"recoil_{case}"].value > np.deg2rad(5.0)  # type: ignore[operator]


@pytest.mark.parametrize(("case", "bound"), [("standard", 0.012), ("long-reach", 0.018)])
def test_arms_make_up_for_the_platform(case: str, bound: float) -> None:
    tools = {
        label: _fly(HoverGrasp(), case, label, end=20.0)[1][f"tools_rmse_{case}"].value
        for label in ("law", "arms-held")
    }
    print(case, tools)
    assert tools["law"] < bound  # type: ignore[operator]
    assert tools["law"] < 0.4 * tools["arms-held"]  # type: ignore[operator]


def test_reaction_compensation_is_needed_where_the_arms_hang_off_the_centre() -> None:
    """Without it the base, let go at the standard hover, is turned three times as far."""
    case = Case("start", "", 1.5, (0.0, 1.5), robot="dual_arm_standard")
    tilts = {}
    for share in (0.0, 1.0):
        log, _ = _fly(Hover(cases=(replace(case, parameters={"reaction": share}),)), "start")
        tilts[share] = np.abs(log["q_WB"][:, 2]).max() * 2
    print("pitch after the start, without and with compensation, rad", tilts)
    assert tilts[1.0] < 0.5 * tilts[0.0]
