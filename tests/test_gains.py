"""Laws and estimators are found by name, and a robot's gains are checked by name, unit and shape."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.estimation import estimators
from aerotact.exceptions import MissingCapability, RobotError
from aerotact.laws import laws
from aerotact.resources import robot_folders
from aerotact.robot import load_robot
from aerotact.robot_file import Quantity


def _with_gains(model: Model, **gains: Quantity) -> Model:
    robot = model.robot
    file = robot.file.model_copy(update={"gains": {"ryll2019_pose_control": gains}})
    return Model(replace(robot, file=file))


def test_every_block_has_the_name_it_is_found_by() -> None:
    models = [model_of(load_robot(folder)) for folder in robot_folders().values()]
    found = {**laws(), **estimators()}
    assert {"ryll2019_admittance", "ryll2019_pose_control", "wrench_observer", "state_estimator"} <= set(found)
    built = set()
    for (name, build), model in product(found.items(), models):
        try:
            block = build(model, 500.0)
        except MissingCapability:
            continue
        built.add(name)
        assert block.name == name
        assert block.rate == 500.0
        for layout in (block.state, block.measurement, block.reference, block.parameters, block.output):
            assert all(port.unit for port in layout)
    assert built == set(found)  # each fits a robot


def test_gains_become_defaults(hexarotor: Model) -> None:
    gain = Quantity(value=[1.0, 2.0, 3.0], unit="1/s", source="assumed")
    block = laws()["ryll2019_pose_control"](_with_gains(hexarotor, K_p1=gain), 500.0)
    np.testing.assert_array_equal(block.parameters.unpack(block.parameters.default)["K_p1"], [1, 2, 3])


@pytest.mark.parametrize(
    ("name", "value", "unit", "message"),
    [
        ("K_p9", 1.0, "1/s", r"robot\.toml: gains\.ryll2019_pose_control\.K_p9: .*no parameter.*name one of: K_p1"),
        ("K_p1", 1.0, "N/m", r"gains\.ryll2019_pose_control\.K_p1: unit is 'N/m'; give it in '1/s'"),
        ("K_p1", [1.0, 2.0], "1/s", r"gains\.ryll2019_pose_control: .*K_p1: 2 numbers given; valid: 3"),
    ],
)
def test_wrong_gains_are_refused(hexarotor: Model, name: str, value: float, unit: str, message: str) -> None:
    gains = {name: Quantity(value=value, unit=unit, source="assumed")}
    with pytest.raises(RobotError, match=message):
        laws()["ryll2019_pose_control"](_with_gains(hexarotor, **gains), 500.0)
