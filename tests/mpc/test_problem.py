"""Ocp files that cannot be used: each fault is one message with the file, the key and what would be valid."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerotact.codegen.mpc_project import mpc_project
from aerotact.dynamics.model import Model
from aerotact.exceptions import MissingCapability, ProblemError, UnknownName
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.mpc.problem import load_problem

TIMES = "times = [0.0, 0.01, 0.02]"
FAULTS = {
    "unknown residual": (
        "[residuals.rate]",
        "[residuals.jerk]",
        r"residuals: unknown 'jerk'; valid: admittance, .*twist",
    ),
    "unknown term": (
        "angular = 4.0",
        "spin = 1.0",
        r"residuals\.admittance\.weight\.spin: .*valid: position, attitude",
    ),
    "unknown constraint": (
        "[constraints]\n",
        '[constraints]\nwind = "hard"\n',
        r"constraints: unknown 'wind'; valid: approach_speed, attitude_tilt, .*thrust, thrust_rate",
    ),
    "soft constraint": ('thrust = "hard"', 'thrust = "soft"', r"constraints\.thrust: .*'hard' \(got 'soft'\)"),
    "unknown fallback": (
        '"ryll2019_admittance" ',
        '"pid" ',
        r"problem\.fallback: unknown 'pid'; valid: .*ryll2019_admittance,",
    ),
    "unknown need": (
        '"tool"]',
        '"wings"]',
        r"problem\.needs: unknown \['wings'\]; valid: .*six_axis_wrench, .*tilt, tool",
    ),
    "unknown key": (
        "max_failures = 5",
        "max_faults = 5",
        r"problem\.max_faults: Extra .*valid: .*delay, doc, duration, fallback",
    ),
    "unknown table": ("[solver]", "[solvers]", r"solvers: Extra .*valid: constraints, parameters, problem, residuals"),
    "unknown solver key": ("backend =", "engine =", r"solver\.engine: Extra .*valid: backend, iterations"),
    "unknown residual key": ("weight = 1e-3", "wait = 1e-3", r"residuals\.thrust\.w(ait|eight): "),
    "no weight": ("weight = 1e-3", "", r"residuals\.thrust\.weight: Field required"),
    "negative weight": ("weight = 1e-3", "weight = -1e-3", r"residuals\.thrust\.weight: .*greater than or equal to 0"),
    "negative term": ("angular = 4.0", "angular = -1.0", r"residuals\.admittance\.weight.*angular"),
    "weight that is no number": ("weight = 1e-3", "weight = nan", r"residuals\.thrust\.weight: .*\(got nan\)"),
    "endless weight": ("weight = 1e-3", "weight = inf", r"residuals\.thrust\.weight: .*\(got inf\)"),
    "weights of another size": (
        "position = 400.0",
        "position = [1.0, 2.0]",
        r"weight\.position: has 2 numbers; give one, or 3",
    ),
    "weight as parameter": (
        "[parameters]",
        "[parameters]\nweight_rate = -1.0",
        r"parameters\.weight_rate: is a weight",
    ),
    "unknown parameter": (
        "[parameters]",
        "[parameters]\nmass = 1.0",
        r"parameters: unknown port 'mass'; valid: .*M_EP",
    ),
    "parameter of another size": (
        "M_EP = 1.5",
        "M_EP = [1.5, 1.5]",
        r"parameters: port M_EP: 2 numbers given; valid: 3",
    ),
    "parameter that is no number": ("M_EP = 1.5", "M_EP = nan", r"parameters\.M_EP.*: .*\(got nan\)"),
    "no rate": ("rate = 100.0", "rate = 0.0", r"problem\.rate: .*greater than 0"),
    "endless rate": ("rate = 100.0", "rate = inf", r"problem\.rate: .*\(got inf\)"),
    "no number": ("terminal = 0.3", 'terminal = "long"', r"problem\.terminal: .*\(got 'long'\)"),
    "negative damping": ("levenberg_marquardt = 1e-6", "levenberg_marquardt = -1.0", r"solver\.levenberg_marquardt"),
    "broken TOML": ("[solver]", "[solver", r"file: is not TOML: .*line \d+.*; mend the named line"),
}
GRIDS = {
    "one node": ("times = [0.0]", "times must start at 0 and increase"),
    "late start": ("times = [0.01, 0.02]", "times must start at 0 and increase"),
    "decreasing times": ("times = [0.0, 0.01, 0.03, 0.02]", "times must start at 0 and increase"),
    "standing times": ("times = [0.0, 0.01, 0.01]", "times must start at 0 and increase"),
    "time that is no number": ("times = [0.0, 0.01, nan]", r"problem\.times\.2: .*\(got nan\)"),
    "endless time": ("times = [0.0, 0.01, inf]", r"problem\.times\.2: .*\(got inf\)"),
    "first interval too long": (
        "times = [0.0, 0.02, 0.03]",
        r"first interval is 0\.02 s; it must be one period, 0\.01 s",
    ),
    "no intervals": ("steps = 0\nduration = 1.0", r"problem\.steps: .*greater than 0"),
    "no duration": ("steps = 10\nduration = 0.0", r"problem\.duration: .*greater than 0"),
    "endless duration": ("steps = 10\nduration = inf", r"problem\.duration: .*\(got inf\)"),
    "steps without duration": ("steps = 10", "steps needs a duration"),
    "no grid": ("", "give either times, or steps and duration"),
    "two grids": (f"{TIMES}\nsteps = 10\nduration = 0.1", "give either times, or steps and duration"),
    "uniform grid of another period": ("steps = 10\nduration = 1.0", r"first interval is 0\.1 s"),
}


def _with_grid(text: str, grid: str) -> str:
    start, end = text.index("times = ["), text.index("]\n", text.index("times = [")) + 1
    return text[:start] + grid + text[end:]


def _refused(path: Path, text: str, model: Model) -> str:
    path.write_text(text)
    with pytest.raises(ProblemError) as caught:
        load_ocp(path, model)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_fault_is_named(fault: str, tmp_path: Path, problem_text: str, hexarotor: Model) -> None:
    old, new, expected = FAULTS[fault]
    assert problem_text.count(old) >= 1
    message = _refused(tmp_path / "spoilt.toml", problem_text.replace(old, new, 1), hexarotor)
    assert re.search(expected, message), message


@pytest.mark.parametrize("fault", sorted(GRIDS))
def test_grid_fault_is_named(fault: str, tmp_path: Path, problem_text: str, hexarotor: Model) -> None:
    grid, expected = GRIDS[fault]
    message = _refused(tmp_path / "spoilt.toml", _with_grid(problem_text, grid), hexarotor)
    assert ": problem" in message
    assert re.search(expected, message), message


@pytest.mark.parametrize("stem", ["two-words", "9lives", "größe", "with space"])
def test_file_name_must_be_a_c_identifier(stem: str, tmp_path: Path, problem_text: str, hexarotor: Model) -> None:
    message = _refused(tmp_path / f"{stem}.toml", problem_text, hexarotor)
    assert f"file: '{stem}' is no C identifier; name it with letters, digits and _" in message


def test_unknown_back_end(tmp_path: Path, problem_text: str, hexarotor: Model) -> None:
    path = tmp_path / "spoilt.toml"
    path.write_text(problem_text.replace('backend = "aerotact"', 'backend = "oracle"'))
    with pytest.raises(UnknownName, match=rf"back end 'oracle' in {path}, solver\.backend; valid: .*aerotact"):
        mpc_project(load_ocp(path, hexarotor))


def test_unknown_problem(hexarotor: Model) -> None:
    with pytest.raises(UnknownName, match=r"unknown optimal control problem 'nothing'; valid: .*tilt_hex_admittance"):
        load_ocp("nothing", hexarotor)


def test_file_that_is_no_text(tmp_path: Path, hexarotor: Model) -> None:
    path = tmp_path / "spoilt.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProblemError, match=r"spoilt\.toml: file: is not TOML"):
        load_ocp(path, hexarotor)


def test_robot_without_a_tool_is_told_what_it_lacks(tmp_path: Path, hexarotor: Model, problem_text: str) -> None:
    robot = hexarotor.robot
    bare = Model(replace(robot, has_tool=False))
    path = tmp_path / "problem.toml"
    path.write_text(problem_text)
    with pytest.raises(
        MissingCapability, match=r"problem 'problem' needs tool, which robot 'tilt_hex' .*it has: .*six_axis"
    ):
        load_ocp(path, bare)


def test_uniform_grid(tmp_path: Path, problem_text: str) -> None:
    path = tmp_path / "uniform.toml"
    path.write_text(_with_grid(problem_text, "steps = 20\nduration = 0.2"))
    _, file = load_problem(path)
    np.testing.assert_allclose(file.problem.nodes, 0.01 * np.arange(21), rtol=1e-15)


def test_file_sets_weights_and_parameters(hexarotor_ocp: Ocp) -> None:
    values = hexarotor_ocp.parameters.unpack(hexarotor_ocp.parameters.default)
    np.testing.assert_array_equal(values["weight_admittance_position"], [400.0, 400.0, 400.0])
    np.testing.assert_array_equal(values["weight_rate"], np.full(6, 1e-5))
    np.testing.assert_array_equal(values["M_ER"], [0.01, 0.01, 0.02])
    np.testing.assert_array_equal(hexarotor_ocp.times[[0, 1, -1]], [0.0, 0.01, 1.02])
