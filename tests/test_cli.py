"""The command line: what each command does, its exit codes, and one clear line for each thing that can be wrong."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from aerotact import __version__, cli
from aerotact.experiments import experiments, ryll2019
from aerotact.experiments.experiment import Case
from aerotact.experiments.ryll2019 import FreeFlight
from aerotact.log import read_columns
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.plant import Plant

ROOT = Path(__file__).parents[1]
OCTOROTOR = str(ROOT / "tests" / "fixtures" / "octorotor")
TOUR = "ryll2019/free-flight"
COMMANDS = ("list", "check", "generate", "fly", "compare")


@dataclass(frozen=True)
class Ended:
    code: int
    out: str
    error: str

    @property
    def one_error(self) -> str:
        """The only line of standard error."""
        (line,) = self.error.splitlines()
        return line


Run = Callable[..., Ended]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Calls the entry point with these words, without OpenGL."""
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    monkeypatch.setattr(cli, "_OPENGL", "disabled")

    def call(*words: str | Path) -> Ended:
        monkeypatch.setattr(sys, "argv", ["aerotact", *map(str, words)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = int(end.code or 0)
        return Ended(code, *capsys.readouterr())

    return call


@pytest.fixture
def short_tour(monkeypatch: pytest.MonkeyPatch) -> FreeFlight:
    """The tour's first second in place of the whole."""
    tour = replace(FreeFlight(), cases=(Case("tour", "its start", 6.0, (5.0, 6.0)),))
    monkeypatch.setattr(ryll2019, "EXPERIMENTS", (tour,))
    return tour


@pytest.fixture
def explosion(monkeypatch: pytest.MonkeyPatch, short_tour: FreeFlight) -> None:
    """The short tour ends after half a second."""

    class Explosion:
        def begin(self, plant: Plant) -> None: ...

        def apply(self, plant: Plant) -> None:
            if plant.time > 0.4995:
                plant.push(plant.base_id, np.full(3, 1e14), np.zeros(3))

    def disturbances(*_: object) -> list[Disturbance]:
        return [Explosion()]

    monkeypatch.setattr(FreeFlight, "disturbances", disturbances)


# help and list


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command_has_an_example(run: Run, command: str) -> None:
    ended = run(command, "--help")
    assert ended.code == 0
    assert f"aerotact {command}" in ended.out
    assert "Example" in ended.out


def test_help_and_version(run: Run) -> None:
    ended = run("--help")
    assert ended.code == 0
    assert all(command in ended.out for command in COMMANDS)
    assert run("--version").out == f"aerotact {__version__}\n"
    assert run().code == 2
    assert run("no-such-command").code == 2


def test_list_names_everything(run: Run) -> None:
    ended = run("list")
    assert ended.code == 0
    for name in ("tilt_hex", "ryll2019_admittance", "state_estimator", "tilt_hex_admittance", *experiments()):
        assert name in ended.out


# check


def test_check_of_a_sound_robot(run: Run, tmp_path: Path) -> None:
    ended = run("check", OCTOROTOR, "--json", tmp_path / "new" / "check.json")
    assert ended.code == 0, ended.out
    assert ended.out.count(" ok ") == 8
    content = json.loads((tmp_path / "new" / "check.json").read_text())
    assert content["passed"] is True
    assert content["robot"] == "octorotor"
    assert all(set(item) == {"name", "passed", "detail"} for item in content["items"])


def test_check_of_a_folder_that_is_no_robot(run: Run, tmp_path: Path) -> None:
    ended = run("check", tmp_path, "--json", tmp_path / "check.json")
    assert ended.code == 1
    content = json.loads((tmp_path / "check.json").read_text())
    assert content["passed"] is False
    assert content["items"][0]["detail"].startswith(f"{tmp_path}/robot.toml: file: does not exist; ")


# generate


@pytest.mark.parametrize("name", ["ryll2019_admittance", "wrench_observer", "tilt_hex_admittance"])
def test_generate(run: Run, tmp_path: Path, name: str) -> None:
    ended = run("generate", name, "--robot", "tilt_hex", "-o", tmp_path / "out")
    assert ended.code == 0
    written = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file()}
    wanted = {f"include/{name}.h", f"src/{name}.c", "example/main.c", "Makefile", "CMakeLists.txt", "manifest.json"}
    assert wanted <= written
    assert f"wrote {len(written)} files" in ended.out
    assert f"make -C {tmp_path / 'out'} run" in ended.out
    # A second time it replaces what it wrote.
    assert run("generate", name, "--robot", "tilt_hex", "-o", tmp_path / "out").code == 0


def test_generated_project_runs_as_told(run: Run, tmp_path: Path) -> None:
    ended = run("generate", "ryll2019_admittance", "-r", OCTOROTOR, "-o", tmp_path / "my law", "--rate", "250")
    assert ended.code == 0
    built = subprocess.run(["make", "-C", tmp_path / "my law", "run"], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert json.loads((tmp_path / "my law" / "manifest.json").read_text())["rate_hz"] == 250.0


def test_generate_leaves_other_folders_alone(run: Run, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    ended = run("generate", "wrench_observer", "-r", "tilt_hex", "-o", tmp_path)
    assert ended.code == 5
    assert f"{tmp_path}: is not empty" in ended.one_error
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


# fly and compare


def test_fly_writes_a_log_and_a_plot(run: Run, tmp_path: Path, short_tour: FreeFlight) -> None:
    ended = run("fly", TOUR, "--controller", "law", "--seed", "3", "--truth", "--delay", "0.002", "-o", tmp_path)
    assert ended.code == 0, ended.error
    folder = tmp_path / "ryll2019" / "free-flight" / "law"
    summary = json.loads((folder / "tour" / "seed3.json").read_text())
    assert (summary["seed"], summary["delay"], summary["state"]) == (3, 0.002, "truth")
    assert summary["controller"] == "law"
    assert summary["statuses"] == {"OK": 3000}
    assert len(read_columns(folder / "tour" / "seed3.parquet")["p_WE"]) == 600
    assert (folder / "tracking.png").read_bytes().startswith(b"\x89PNG")
    assert f"log:     {folder / 'tour' / 'seed3.parquet'}" in ended.out
    assert f"plot:    {folder / 'tracking.png'}" in ended.out
    assert "steps of controller: 3000 OK" in ended.out
    assert "position_error_max" in ended.out


def test_fly_takes_the_path_of_an_ocp_file(run: Run, tmp_path: Path, short_tour: FreeFlight) -> None:
    own = tmp_path / "mine" / "tilt_hex_admittance.toml"
    own.parent.mkdir()
    own.write_text((ROOT / "ocp" / "tilt_hex_admittance.toml").read_text())
    ended = run("fly", TOUR, "-c", own, "-o", tmp_path / "out")
    assert ended.code == 0, ended.error
    assert (tmp_path / "out" / TOUR / "tilt_hex_admittance" / "tour" / "seed0.parquet").is_file()
    assert [p.name for p in own.parent.iterdir()] == [own.name]


def test_compare_writes_table_numbers_plots_and_page(run: Run, tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    ended = run("compare", TOUR, "--seeds", "1", "--jobs", "2", "-o", tmp_path / "out", "--json", numbers)
    assert ended.code == 0, ended.error
    folder = tmp_path / "out" / "ryll2019" / "free-flight"
    assert numbers.read_bytes() == (folder / "compare.json").read_bytes()
    content = json.loads(numbers.read_text())
    assert list(content["controllers"]) == ["law", "law-tuned", "mpc"]
    for label, metrics in content["controllers"].items():
        assert metrics["position_error_max"]["mean"] < 0.02
        assert (folder / label / "tour" / "seed0.parquet").is_file()
    assert "data:image/png" in (folder / "report.html").read_text()
    for word in ("position_error_max, mm", "law-tuned", f"page:    {folder / 'report.html'}", "no picture: MUJOCO_GL"):
        assert word in ended.out


def test_fly_that_fails_under_way_keeps_its_log(run: Run, tmp_path: Path, explosion: None) -> None:
    ended = run("fly", TOUR, "-c", "law", "-o", tmp_path)
    assert ended.code == 6
    assert "ended early: plant stopped at 0.50" in ended.one_error
    assert len(read_columns(tmp_path / TOUR / "law" / "tour" / "seed0.parquet")["time"]) == 50


def test_compare_tells_of_runs_that_failed(run: Run, tmp_path: Path, explosion: None) -> None:
    ended = run("compare", TOUR, "-c", "law", "-c", "law-tuned", "--seeds", "1", "-j", "1", "-o", tmp_path)
    assert ended.code == 6
    assert len(ended.error.splitlines()) == 2
    assert "ended early: law-tuned tour seed 0: plant stopped at 0.50" in ended.error
    assert len(json.loads((tmp_path / TOUR / "compare.json").read_text())["faults"]) == 2
    assert (tmp_path / TOUR / "report.html").is_file()
    assert (tmp_path / TOUR / "law" / "tour" / "seed0.parquet").is_file()


# what can be wrong

WRONG = {
    # words: (exit code, what the line names)
    ("check", "no_such"): (2, ("unknown robot 'no_such'", "tilt_hex")),
    ("generate", "no_such", "-r", "tilt_hex", "-o", "{tmp}/out"): (
        2,
        ("'no_such'", "ryll2019_admittance", "wrench_observer"),
    ),
    ("generate", "wrench_observer", "-r", "no_such", "-o", "{tmp}/out"): (2, ("unknown robot 'no_such'", "tilt_hex")),
    ("generate", "wrench_observer", "-r", "tilt_hex", "-o", "{tmp}/out", "--rate", "0"): (
        2,
        ("--rate is 0 Hz", "valid: 1"),
    ),
    ("generate", "tilt_hex_admittance", "-r", "tilt_hex", "-o", "{tmp}/out", "--rate", "50"): (
        2,
        ("100 Hz", "ocp file"),
    ),
    ("generate", "wrench_observer", "-r", "tilt_hex", "-o", "{file}/out"): (5, ("cannot be written", "valid:")),
    ("fly", "no/such", "-c", "law"): (2, ("unknown experiment 'no/such'", TOUR)),
    ("fly", TOUR, "-c", "pid"): (2, ("unknown controller 'pid'", "law-tuned", "tilt_hex_admittance")),
    ("fly", TOUR, "-c", "law", "--case", "K6"): (2, ("unknown case 'K6'", TOUR, "tour")),
    ("fly", TOUR, "-c", "law", "--delay", "soon"): (2, ("--delay is 'soon'", "'measured'")),
    ("fly", TOUR, "-c", "law", "--delay", "-1"): (2, ("--delay is -1 s", "0 to 1 s")),
    ("fly", TOUR, "-c", "law", "--delay", "nan"): (2, ("--delay is nan s", "0 to 1 s")),
    ("fly", TOUR, "-c", "law", "-r", "no_such"): (2, ("unknown robot 'no_such'", "tilt_hex")),
    ("fly", TOUR, "-c", "ryll2019_admittance_filter"): (6, ("cannot fly", "thrust_cmd")),
    ("fly", TOUR, "-c", "ryll2019_pose_control"): (6, ("reference p_WB_r", "there is: p_WE_d")),
    ("fly", TOUR, "-c", "law", "-o", "{file}/out"): (2, ("{file}/out", "cannot be made", "valid:")),
    ("compare", "no/such"): (2, ("unknown experiment 'no/such'", TOUR)),
    ("compare", TOUR, "-c", "pid"): (2, ("unknown controller 'pid'", "mpc")),
    ("compare", TOUR, "--case", "K6"): (2, ("unknown case 'K6'", "tour")),
    ("compare", TOUR, "-r", "{tmp}"): (3, ("{tmp}/robot.toml", "does not exist")),
    ("compare", TOUR, "-o", "{file}/out"): (2, ("{file}/out", "cannot be made", "valid:")),
    ("check", "tilt_hex", "--json", "{file}/check.json"): (2, ("{file}", "cannot be", "valid:")),
}


@pytest.mark.parametrize("words", WRONG, ids=" ".join)
def test_one_line_for_what_is_wrong(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    code, named = WRONG[words]
    places = {"tmp": str(tmp_path), "file": str(tmp_path / "file")}
    (tmp_path / "file").write_text("a file where a folder is wanted")
    monkeypatch.chdir(tmp_path)
    ended = run(*(word.format(**places) for word in words))
    assert ended.code == code
    assert ended.one_error.startswith("error: ")
    for part in named:
        assert part.format(**places) in ended.one_error
    left = [p.name for p in tmp_path.rglob("*") if p.is_file()]
    assert left == ["file"]


@pytest.mark.parametrize("command", [("fly", TOUR, "-c", "law"), ("compare", TOUR, "--seeds", "1")])
def test_no_compiler(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("AEROTACT_CACHE", str(tmp_path / "cache"))
    ended = run(*command, "-o", tmp_path / "out")
    assert ended.code == 5
    assert "no C compiler found (tried cc, gcc, clang); install gcc or clang, or set the variable CC" in ended.one_error


@pytest.mark.parametrize("backend", ["disabled", "no_such_backend"])
def test_missing_opengl_costs_nothing_but_the_picture(backend: str, tmp_path: Path) -> None:
    """In a process of its own, since MuJoCo reads the variable when it is imported."""
    environment = os.environ | {"MUJOCO_GL": backend, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "aerotact.cli", "fly", TOUR, "-c", "law", "-o", str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    told = [line for line in done.stdout.splitlines() if "picture" in line]
    assert len(told) == 1
    assert (tmp_path / TOUR / "law" / "tour" / "seed0.parquet").is_file()
    # With a backend that is not there, another one may serve.
    assert (tmp_path / TOUR / "tilt_hex.png").is_file() == told[0].startswith("picture: ")
    if backend == "disabled":
        assert told == ["no picture: MUJOCO_GL is 'disabled'"]
