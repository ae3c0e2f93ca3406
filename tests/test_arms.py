"""Arms and passive joints of a robot folder: what is read, and every spoilt folder refused by name."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from aerotact.exceptions import RobotError
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[1] / "models"
LONG = "dual_arm_long_reach"
PITCH = 'class="shoulder_pitch"'
SERVO = 'gainprm="2.93" biasprm="0 -2.93 -0.07"'


def test_arms_have_the_papers_numbers() -> None:
    """suarez2020 Table 2 and 'Compliant joint control'."""
    for name, mass in (("dual_arm_standard", 4.66), (LONG, 4.91)):
        robot = load_robot(MODELS / name)
        assert robot.mass == pytest.approx(mass, rel=1e-14)  # 2.46 + 0.9 + 1.3, and the pendulum's 0.25 kg
        arms = robot.mjmodel.body("arm_shoulders").id
        assert robot.mjmodel.body_subtreemass[arms] == pytest.approx(1.3, rel=1e-14)
        assert [arm.name for arm in robot.arms] == ["left", "right"]
        for arm in robot.arms:
            assert [j.name.split("_", 2)[2] for j in arm.joints] == [
                "shoulder_pitch",
                "shoulder_roll",
                "shoulder_yaw",
                "elbow_pitch",
            ]
            np.testing.assert_array_equal([j.stiffness for j in arm.joints], [2.93, 2.1, 0.8, 1.48])
            np.testing.assert_array_equal([j.torque for j in arm.joints], [2.34, 2.34, 1.17, 2.34])
            np.testing.assert_array_equal([j.time_constant for j in arm.joints], 0.05)
            degrees = np.rad2deg([j.range for j in arm.joints])
            np.testing.assert_allclose(degrees, [[-90, 90], [-10, 90], [-90, 90], [-135, 135]], atol=1e-12)
            np.testing.assert_allclose([j.servo for j in arm.joints], np.deg2rad(degrees), atol=1e-15)
    assert [j.name for j in robot.passive] == ["swing"]
    assert robot.passive[0].damping == 0.02


def test_deflections_at_hover_are_within_the_linear_range() -> None:
    for name in ("dual_arm_standard", LONG):
        robot = load_robot(MODELS / name)
        key = robot.mjmodel.key("hover")
        for arm in robot.arms:
            q = np.array([key.qpos[robot.mjmodel.jnt_qposadr[j.index]] for j in arm.joints])
            np.testing.assert_array_equal(q, [0.0, 0.0, 0.0, -np.pi / 2])
            deflection = np.array([key.ctrl[j.actuator_index] for j in arm.joints]) - q
            assert 0.02 < np.abs(deflection).max() < np.deg2rad(10.0)


SPOILT = {
    # name: (file, old text, new text, part of the message that must be named)
    "unknown tool": ("robot.toml", 'tool = "arm_right_tip"', 'tool = "right_tip"', "arms[1].tool"),
    "unknown joint": ("robot.toml", '"arm_left_shoulder_roll", ', '"left_roll", ', "arms[0].joints[1]"),
    "two arms of one name": ("robot.toml", 'name = "right"', 'name = "left"', "arms[1].name"),
    "name that C cannot bear": ("robot.toml", 'name = "right"', 'name = "the right"', "arms.1.name"),
    "joint of both arms": (
        "robot.toml",
        '["arm_right_shoulder_pitch"',
        '["arm_left_shoulder_pitch"',
        "arms[1].joints[0]",
    ),
    "joint in no list": ("robot.toml", '[passive]\njoints = ["swing"]', "", "arms"),
    "rates of three joints": ("robot.toml", "[7.1, 7.1, 6.3, 7.1]", "[7.1, 7.1, 6.3]", "arms[0].servo_rate"),
    "rate in degrees": (
        "robot.toml",
        'unit = "rad/s", source = "data',
        'unit = "deg/s", source = "data',
        "arms[0].servo_rate",
    ),
    "tool of the other arm": (
        "robot.toml",
        'name = "right"\ntool = "arm_right',
        'name = "right"\ntool = "arm_left',
        "arms[1].tool",
    ),
    "free joint": ("robot.toml", '["swing"]', '["base_free"]', "joint 'base_free'"),
    "passive joint that is driven": ("robot.toml", '["swing"]', '["arm_left_elbow_pitch"]', "passive.joints[0]"),
    "passive joint twice": ("robot.toml", '["swing"]\n\n', '["swing", "swing"]\n\n', "passive.joints[1]"),
    "servo without lag": (
        "parts",
        'dyntype="filterexact" dynprm="0.05"',
        'dyntype="filterexact" dynprm="0"',
        "actuator 'arm_left_shoulder_pitch'",
    ),
    "bias that is no spring": (
        "parts",
        SERVO,
        'gainprm="2.93" biasprm="0 -2 -0.07"',
        "actuator 'arm_left_shoulder_pitch'",
    ),
    "no stall torque": ("parts", ' forcerange="-2.34 2.34"', "", "actuator 'arm_left_shoulder_pitch'"),
    "stall torque one way": ("parts", 'forcerange="-2.34', 'forcerange="0', "actuator 'arm_left_shoulder_pitch'"),
    "no range": (
        "parts",
        '<joint axis="0 1 0" range="-90 90"/>',
        '<joint axis="0 1 0"/>',
        "actuator 'arm_left_shoulder_pitch'",
    ),
    "gear": (
        "parts",
        f'joint="left_shoulder_pitch" {PITCH}',
        f'joint="left_shoulder_pitch" gear="2" {PITCH}',
        "actuator 'arm_left_shoulder_pitch'",
    ),
    "joint without a servo": (
        "parts",
        f'<general name="left_shoulder_pitch" joint="left_shoulder_pitch" {PITCH}/>',
        "",
        None,
    ),
    "hover without activation": ("plant.xml", "-0.03594486", "-0.03", "hover keyframe"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt_folder_is_refused(case: str, tmp_path: Path) -> None:
    file, old, new, part = SPOILT[case]
    for folder in ("parts", LONG):
        shutil.copytree(MODELS / folder, tmp_path / folder)
    path = tmp_path / "parts" / "dual_arm.xml" if file == "parts" else tmp_path / LONG / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    if case == "joint without a servo":  # the keyframe then has an activation too many
        plant = tmp_path / LONG / "plant.xml"
        plant.write_text(re.sub(r'(act|ctrl)="(\S+ \S+ \S+ \S+ \S+ \S+) \S+', r'\1="\2', plant.read_text()))
        part = "joint 'arm_left_shoulder_pitch'"
    with pytest.raises(RobotError) as caught:
        load_robot(tmp_path / LONG)
    assert caught.value.part == part, str(caught.value)
    assert str(tmp_path) in caught.value.file
    assert caught.value.remedy


def test_part_that_is_missing_is_named(tmp_path: Path) -> None:
    shutil.copytree(MODELS / LONG, tmp_path / LONG)
    with pytest.raises(RobotError, match=r"plant\.xml: model: .*hexarotor\.xml"):
        load_robot(tmp_path / LONG)
