"""The contract of a folder with arms: sound ones pass; each spoilt one fails at its item with file, part and remedy."""

import re
import shutil
from pathlib import Path

import pytest

from aerotact.check import check_robot

MODELS = Path(__file__).parents[1] / "models"
LONG = "dual_arm_long_reach"
LOADS, TRIM, LIFT = "loads without a MuJoCo warning", "hover keyframe is exact trim", "rotors lift and turn the base"
AGREE, LIMITS, SENSORS = (
    "CasADi accelerations equal MuJoCo's",
    "limits are consistent",
    "sensors are there and their rates fit",
)

SPOILT = {
    # name: (file, old text, new text, item that fails, what its text names)
    "arm not listed": (
        f"{LONG}/robot.toml",
        r'(?s)\[\[arms\]\]\nname = "right".*?\n\n',
        "",
        LOADS,
        ("'arm_right_shoulder_pitch'", "0 lists"),
    ),
    "passive joint not listed": (
        f"{LONG}/robot.toml",
        r'\[passive\]\njoints = \["swing"\]',
        "",
        LOADS,
        ("'swing'", "under passive"),
    ),
    "friction of a joint": (
        "parts/dual_arm.xml",
        r'<joint axis="0 1 0" range="-90 90"/>',
        '<joint axis="0 1 0" range="-90 90" frictionloss="0.1"/>',
        AGREE,
        ("leave out",),
    ),
    "spring of the pendulum": (
        f"{LONG}/plant.xml",
        r'damping="0.02"',
        'damping="0.02" stiffness="1"',
        TRIM,
        ("balance the passive joints",),
    ),
    "heavier forearm": (
        "parts/dual_arm.xml",
        r'mass="0.10" diaginertia="5.13',
        'mass="0.11" diaginertia="5.13',
        TRIM,
        ("set ctrl and act",),
    ),
    "drag of one sign": ("parts/hexarotor.xml", r'0 -0.016"', '0 0.016"', LIFT, ("rank 3", "both ways")),
    "rotors in a row": (
        "parts/hexarotor_body.xml",
        r'(name="rotor\d" pos="\S+) \S+',
        r"\1 0",
        LIFT,
        ("rank 3", "around the base"),
    ),
    "servo rate in deg/s": (
        f"{LONG}/robot.toml",
        r"\[7.1, 7.1, 6.3, 7.1\]",
        "[4e2, 4e2, 4e2, 1e4]",
        LIMITS,
        ("servo_rate", "shoulder_roll", "check its unit"),
    ),
    "narrow servo": (
        "parts/dual_arm.xml",
        r'ctrlrange="-2.356194490192345',
        'ctrlrange="-1.6',
        LIMITS,
        ("elbow_pitch", "widen"),
    ),
    "weak servo": (
        "parts/dual_arm.xml",
        r'forcerange="-2.34 2.34"',
        'forcerange="-0.1 0.1"',
        LIMITS,
        ("hover needs", "another pose"),
    ),
    "encoder at 333 Hz": (f"{LONG}/robot.toml", r"rate = 200.0", "rate = 333.0", SENSORS, ("1000 Hz",)),
}


def _failed(folder: Path) -> dict[str, str]:
    return {item.name: item.detail for item in check_robot(folder).items if not item.passed}


def _copied(to: Path) -> Path:
    for folder in ("parts", LONG):
        shutil.copytree(MODELS / folder, to / folder)
    return to / LONG


@pytest.mark.parametrize("name", ["dual_arm_standard", LONG])
def test_sound_robot_passes(name: str) -> None:
    report = check_robot(MODELS / name)
    assert report.passed, _failed(MODELS / name)
    assert LIFT in [item.name for item in report.items]
    assert "state_estimator" in report.fits
    assert any("ryll2019_pose_control needs rigid_body, six_axis_wrench" in misfit for misfit in report.misfits)
    details = {next(i.detail for i in check_robot(MODELS / name, seed).items if i.name == AGREE) for seed in range(3)}
    assert len(details) > 1


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt_robot_fails_at_its_item(case: str, tmp_path: Path) -> None:
    file, old, new, item, named = SPOILT[case]
    folder = _copied(tmp_path)
    path = tmp_path / file
    text, count = re.subn(old, new, path.read_text())
    assert count
    path.write_text(text)
    failed = _failed(folder)
    assert item in failed, failed
    for word in (str(tmp_path), *named):
        assert word in failed[item], failed[item]


def test_remedy_for_the_trim_is_the_cure(tmp_path: Path) -> None:
    folder = _copied(tmp_path)
    plant = folder / "plant.xml"
    sound = plant.read_text()
    text, count = re.subn(r'(act|ctrl)="[^"]*"', lambda m: f'{m[1]}="{" ".join(["1"] * 14)}"', sound)
    assert count == 2
    plant.write_text(text)
    cure = re.search(r'set ctrl and act to "([^"]*)"', _failed(folder)[TRIM])
    assert cure is not None
    plant.write_text(re.sub(r'(act|ctrl)="[^"]*"', lambda m: f'{m[1]}="{cure[1]}"', text))
    assert _failed(folder) == {}
