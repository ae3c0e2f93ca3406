"""Every robot with every law, estimator and problem: it is generated, or the message says what the robot lacks."""

from dataclasses import replace
from pathlib import Path

import pytest

from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import block_project
from aerotact.dynamics.model import CAPABILITIES, Model
from aerotact.dynamics.model_of import model_of
from aerotact.estimation import estimators
from aerotact.exceptions import MissingCapability
from aerotact.laws import laws
from aerotact.mpc.ocp import load_ocp
from aerotact.mpc.problem import load_problem
from aerotact.robot import load_robot

ROOT = Path(__file__).parents[2]
ROBOTS = sorted(p.parent for pattern in ("models/*", "tests/fixtures/*") for p in ROOT.glob(f"{pattern}/robot.toml"))
PROBLEMS = sorted(ROOT.glob("ocp/*.toml"))
BLOCKS = {**laws(), **estimators()}
CONTENT = ("suarez2020_attitude",)  # laws that ask for no tool and no sixth axis
RATE = 250.0


@pytest.fixture(scope="module", params=ROBOTS, ids=lambda p: p.name)
def any_model(request: pytest.FixtureRequest) -> Model:
    return model_of(load_robot(request.param))


def test_there_is_something_to_combine() -> None:
    assert len(ROBOTS) >= 2
    assert PROBLEMS
    assert len(BLOCKS) >= 5


@pytest.mark.parametrize("name", sorted(BLOCKS))
def test_block_generates_or_names_what_is_lacking(any_model: Model, name: str) -> None:
    try:
        project = block_project(BLOCKS[name](any_model, RATE), any_model)
    except MissingCapability as error:
        _check_message(str(error), any_model, name)
        return
    assert project.manifest["robot"] == any_model.robot.name
    assert project.manifest["rate_hz"] == RATE
    assert project.manifest["sizes"]["output"] > 0


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda p: p.stem)
def test_problem_generates_or_names_what_is_lacking(any_model: Model, path: Path) -> None:
    lacking = set(load_problem(path)[1].problem.needs) - any_model.capabilities
    try:
        project = mpc_project(load_ocp(path, any_model))
    except MissingCapability as error:
        _check_message(str(error), any_model, path.stem)
        return
    assert not lacking
    assert project.name == path.stem
    assert project.manifest["robot"] == any_model.robot.name


def _check_message(message: str, model: Model, who: str) -> None:
    assert who in message
    assert f"robot '{model.robot.name}'" in message
    assert any(need in message.split(", which", maxsplit=1)[0] for need in CAPABILITIES)


@pytest.mark.parametrize("name", sorted(laws()))
def test_law_on_a_robot_without_tool_and_sixth_axis_says_so(hexarotor: Model, name: str) -> None:
    robot = hexarotor.robot
    upright = tuple(replace(rotor, axis_B=rotor.axis_B * [0.0, 0.0, 1.0]) for rotor in robot.rotors)
    bare = Model(replace(robot, has_tool=False, rotors=upright))
    assert bare.capabilities == {"fixed_rotors", "rigid_body", "thrust_and_torque"}
    if name in CONTENT:
        assert laws()[name](bare, RATE).output.size == bare.rotors
        return
    with pytest.raises(MissingCapability) as caught:
        laws()[name](bare, RATE)
    _check_message(str(caught.value), bare, name)
    assert str(caught.value).endswith("it has: fixed_rotors, rigid_body, thrust_and_torque")
