"""Nested controllers: what the outer one gives the inner one follows, each at its own rate, both in the log."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from aerotact import compare
from aerotact.codegen.project import block_project
from aerotact.controller import Controller
from aerotact.dynamics.actuators import actuator_limiter
from aerotact.dynamics.model import Model
from aerotact.exceptions import LoopError, UnknownName
from aerotact.experiments.experiment import Case, ControllerSpec
from aerotact.experiments.suarez2020.hover import Hover
from aerotact.flight import Options, estimator_names, fly, robot_of
from aerotact.log import Log
from aerotact.loop import Loop, Wiring
from aerotact.metrics import standard_metrics
from aerotact.plant.plant import Plant
from aerotact.plant.sensors import Sensors
from aerotact.ports import Array, BlockBuilder
from aerotact.robot import load_robot

OUTER, INNER = 50.0, 250.0  # Hz


@dataclass(frozen=True)
class Ramp:
    """A wish that is the time itself; another that nothing but the reference gives."""

    def sample(self, times: Array) -> dict[str, Array]:
        return {"wish": times[:, None], "aside": np.full((len(times), 1), 7.0)}


@pytest.fixture(scope="module")
def model(models: dict[str, Model]) -> Model:
    return models["tilt_hex"]


def _outer(model: Model, name: str = "lift_r", size: int = 1) -> Controller:
    """Counts its steps and hands on the wish."""
    b = BlockBuilder("outer", "example", OUTER, "hands on what it is told")
    wish = b.reference("wish", 1, "s")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion")
    steps = b.state("steps", 1, "1")
    b.update("steps", steps + 1)
    b.output(name, ca.repmat(wish, size, 1), "s")
    b.output("steps", steps + 0 * q_WB[0], "1")
    return Controller(block_project(b.build(), model))


def _inner(model: Model) -> Controller:
    """Thrusts of hover; says what it heard of the outer one and of the reference."""
    b = BlockBuilder("inner", "example", INNER, "hover")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion")
    heard, aside = b.reference("lift_r", 1, "s", default=(-1.0,)), b.reference("aside", 1, "1")
    b.output("thrust_cmd", ca.DM(model.robot.hover_thrust), "N", default=tuple(model.robot.hover_thrust))
    b.output("heard", ca.vertcat(heard, aside) + 0 * q_WB[0], "1")
    b.limit_with(actuator_limiter(model, INNER))
    return Controller(block_project(b.build(), model))


def _fly(model: Model, controllers: Sequence[Controller], delay: float = 0.0) -> Log:
    plant = Plant(model.robot)
    loop = Loop(plant, Sensors(plant, model.robot, 0), [_watcher(model)], controllers, Wiring(Ramp(), True, delay))
    return loop.run(0.2, {})


def _watcher(model: Model) -> Controller:
    """An estimator that gives the attitude's port, so that the loop serves it."""
    b = BlockBuilder("watcher", "example", 500.0, "passes the attitude")
    q_WB = b.measurement("mocap_q_WB", 4, "1", frame="W", kind="quaternion")
    b.output("q_WB", q_WB, "1", frame="W", kind="quaternion")
    return Controller(block_project(b.build(), model))


def test_inner_follows_the_outer_at_its_rate(model: Model) -> None:
    log = _fly(model, [_outer(model), _inner(model)])
    assert log.fault == ""
    rows: Array = np.arange(len(log.time))
    np.testing.assert_allclose(log["lift_r"][:, 0], (rows // 20) * 0.02, atol=1e-12)
    np.testing.assert_allclose(log["heard"][:, 0], (rows // 20) * 0.02, atol=1e-12)
    np.testing.assert_array_equal(log["heard"][:, 1], 7.0)
    np.testing.assert_array_equal(log["steps"][:, 0], rows // 20)
    assert log.statuses == {"OK": 10}
    assert log.inner_statuses == {"inner": {"OK": 50}}
    assert log.every == 20
    assert len(log.solve_times) == 10
    assert {"wish", "aside", "lift_r", "heard", "thrust_cmd", "q_WB_est"} <= set(log.columns)


def test_delay_is_on_the_way_to_the_inner_and_to_the_plant(model: Model) -> None:
    log = _fly(model, [_outer(model), _inner(model)], delay=5e-3)
    # Sent at 0, 20, 40 ms; it arrives 5 ms later, and the inner one steps every 4 ms.
    first = np.array([np.flatnonzero(log["heard"][:, 0] >= 0.02 * k - 1e-9)[0] for k in range(1, 9)])
    np.testing.assert_array_equal(first, [int(np.ceil((20 * k + 5) / 4) * 4) for k in range(1, 9)])
    np.testing.assert_array_equal(log["heard"][:8, 0], -1.0)  # until then the default


def test_stand_ins_of_the_inner_count(model: Model) -> None:
    log = _fly(model, [_outer(model), _inner(model)])
    assert standard_metrics(log, model.robot)["stand_ins"].value == 0
    log.inner_statuses["inner"] = {"OK": 47, "BAD_INPUT": 3}
    assert standard_metrics(log, model.robot)["stand_ins"].value == 3


def test_what_does_not_fit_is_named(model: Model) -> None:
    with pytest.raises(LoopError, match=r"outer gives other, steps, nothing that its inner controller inner follows"):
        _fly(model, [_outer(model, "other"), _inner(model)])
    with pytest.raises(LoopError, match=r"outer gives lift_r of shape \(2,\); valid: \(1,\), of inner"):
        _fly(model, [_outer(model, size=2), _inner(model)])
    with pytest.raises(LoopError, match=r"outer gives lift_r, steps and cannot fly"):
        _fly(model, [_outer(model)])


NESTED = ControllerSpec(
    "suarez2020_position",
    50.0,
    "",
    {"K_swing": 0.1},
    inner=ControllerSpec("suarez2020_attitude", 250.0, "", {"K_q": [6.0, 6.0, 2.0]}),
)


def test_a_case_has_its_robot_and_each_controller_its_parameters() -> None:
    case = Case("short", "", 0.3, (0.0, 0.3), {"K_w": 19.0, "tilt_max": 0.4}, robot="dual_arm_long_reach")
    hover = Hover(controllers={"nested": NESTED}, cases=(case,))
    assert robot_of(hover, case, Options()) == "dual_arm_long_reach"
    assert robot_of(hover, case, Options("dual_arm_standard")) == "dual_arm_standard"
    assert estimator_names(load_robot("dual_arm_standard"))[1:] == ("joint_estimator", "multibody_observer")
    log, result = fly(hover, case, "nested", 0)
    assert result.fault == ""
    assert log.head["robot"] == "dual_arm_long_reach"
    assert log.head["inner"] == ["suarez2020_attitude"]
    assert {"controller", "suarez2020_attitude"} <= set(log.head["inputs"])
    assert result.metrics["violations_thrust"].value == 0
    wrong = Case("wrong", "", 0.3, (0.0, 0.3), {"K_z": 1.0}, robot="dual_arm_long_reach")
    with pytest.raises(UnknownName, match=r"'K_z' in suarez2020_position or suarez2020_attitude, case wrong"):
        fly(hover, wrong, "nested", 0)


def test_comparison_compiles_what_every_case_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[tuple[str, str]] = []
    monkeypatch.setattr(compare, "compile_library", lambda p: compiled.append((p.manifest["robot"], p.name)) or Path())
    compare._compile_all(Hover(controllers={"nested": NESTED}), ["nested"], Hover().cases, Options())
    blocks = ("suarez2020_position", "suarez2020_attitude", "state_estimator", "joint_estimator", "multibody_observer")
    robots = ("dual_arm_standard", "dual_arm_long_reach")
    assert compiled == [(robot, block) for robot in robots for block in blocks]
