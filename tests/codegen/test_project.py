"""Generated projects: the same bytes every time, no trace of place or time, and what write() replaces."""

import hashlib
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject, block_project
from aerotact.dynamics.model import Model
from aerotact.estimation import estimators
from aerotact.exceptions import CodegenError
from aerotact.laws import laws
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import BlockBuilder

_GENERATE = """
import hashlib, sys
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import block_project
from aerotact.dynamics.model import Model
from aerotact.laws import laws
from aerotact.mpc.ocp import load_ocp
from aerotact.robot import load_robot
model = Model(load_robot(sys.argv[1]))
law = laws()["ryll2019_admittance"](model, 500.0)
projects = [block_project(law, model), mpc_project(load_ocp(sys.argv[2], model))]
for project in projects:
    for path, text in project.files.items():
        print(project.name, path, hashlib.sha256(text.encode()).hexdigest())
"""


def _hashes(model: Model, ocp: Ocp) -> list[str]:
    projects = [block_project(laws()["ryll2019_admittance"](model, 500.0), model), mpc_project(ocp)]
    return [
        f"{p.name} {path} {hashlib.sha256(text.encode()).hexdigest()}"
        for p in projects
        for path, text in p.files.items()
    ]


def test_generating_again_gives_the_same_bytes(block: object, block_c: CProject, model: Model) -> None:
    maker = {**laws(), **estimators()}[block_c.name]
    assert dict(block_project(maker(model, 500.0), model).files) == dict(block_c.files)


@pytest.mark.parametrize("seed", ["0", "4242"])
def test_another_process_with_another_hash_seed_gives_the_same_bytes(hexarotor_ocp: Ocp, seed: str) -> None:
    model = hexarotor_ocp.model
    done = subprocess.run(
        [sys.executable, "-c", _GENERATE, str(model.robot.folder), str(hexarotor_ocp.path)],
        env={**os.environ, "PYTHONHASHSEED": seed},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = done.stdout.split("\n")[:-1]
    assert len(lines) > 20
    assert lines == _hashes(model, load_ocp(hexarotor_ocp.path, model))


def _check_traces(project: CProject, model: Model) -> None:
    places = [str(model.robot.folder.parent), str(Path.home()), str(Path.cwd()), os.sep + "tmp" + os.sep]
    for path, text in project.files.items():
        assert not [place for place in places if place in text], path
        assert not re.search(r"\b20\d\d-\d\d-\d\d\b|\d\d:\d\d:\d\d|__DATE__|__TIME__", text), path
        assert text.endswith("\n"), path


def test_block_carries_no_timestamp_and_no_absolute_path(block_c: CProject, model: Model) -> None:
    _check_traces(block_c, model)


def test_mpc_carries_no_timestamp_and_no_absolute_path(mpc_c: CProject, model: Model) -> None:
    _check_traces(mpc_c, model)


def test_manifest_names_ports_sizes_and_the_hashes_of_the_inputs(mpc_c: CProject, ocp: Ocp) -> None:
    manifest = mpc_c.manifest
    robot = ocp.model.robot
    assert manifest["inputs"] == {
        f: hashlib.sha256((robot.folder / f).read_bytes()).hexdigest() for f in ("plant.xml", "robot.toml")
    }
    assert manifest["ocp"]["sha256"] == hashlib.sha256(ocp.path.read_bytes()).hexdigest()
    assert manifest["rate_hz"] == ocp.rate
    assert [p["name"] for p in manifest["ports"]["parameters"]] == [p.name for p in ocp.parameters]
    for group, ports in manifest["ports"].items():
        assert manifest["sizes"][group] == sum(p["size"] * p["nodes"] for p in ports) > 0


def test_digest_follows_the_library_only(block_c: CProject) -> None:
    source = f"src/{block_c.name}.c"
    readme = CProject(block_c.name, {**block_c.files, "README.md": "another"}, block_c.sources)
    changed = CProject(block_c.name, {**block_c.files, source: block_c.files[source] + "\n"}, block_c.sources)
    assert readme.digest == block_c.digest
    assert changed.digest != block_c.digest


def test_write_replaces_an_older_project_and_its_leftovers(tmp_path: Path, block_c: CProject) -> None:
    folder = tmp_path / "made" / "here"
    block_c.write(folder)
    (folder / "src" / "leftover.c").write_text("int leftover;\n")
    (folder / "notes.txt").write_text("mine\n")
    block_c.write(folder)
    written = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert written == {*block_c.files, "notes.txt"}
    assert all((folder / path).read_text() == text for path, text in block_c.files.items())


@pytest.mark.parametrize(
    "manifest",
    [None, "{}", '{"versions": {"web": "1"}}', "[]", "no json"],
    ids=["none", "empty", "other", "list", "text"],
)
def test_write_refuses_a_folder_with_something_else(tmp_path: Path, block_c: CProject, manifest: str | None) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "precious.c").write_text("int precious;\n")
    if manifest is not None:
        (tmp_path / "manifest.json").write_text(manifest)
    with pytest.raises(CodegenError, match=r"is not empty and holds no manifest\.json of aerotact"):
        block_c.write(tmp_path)
    assert (tmp_path / "src" / "precious.c").read_text() == "int precious;\n"


def test_write_names_the_folder_that_it_cannot_make(tmp_path: Path, block_c: CProject) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CodegenError, match=r"file/inside: cannot be written.*valid: a folder"):
        block_c.write(tmp_path / "file" / "inside")


def test_text_of_a_file_cannot_leave_its_comment(hexarotor: Model) -> None:
    block = laws()["ryll2019_pose_control"](hexarotor, 500.0)
    project = block_project(replace(block, doc="ends */ early\n#error here\n"), hexarotor)
    header = project.files[f"include/{block.name}.h"]
    assert header.startswith("/* ryll2019_pose_control: ends * / early #error here\n")
    assert json.loads(project.files["manifest.json"])["name"] == block.name


def test_block_without_state_parameters_and_reference_compiles(tmp_path: Path, hexarotor: Model) -> None:
    b = BlockBuilder("bare", "aerotact", 100.0, "one number in, one out")
    b.output("p_WE_r", b.measurement("p_WB", 3, "m") * 2, "m")
    b.output("single", b.measurement("mocap_fresh", 1, "1", kind="flag"), "1")
    project = block_project(b.build(), hexarotor)
    assert "double single[1];" in project.files["include/bare.h"]
    assert project.files["include/bare.h"].count("double unused;") == 2
    project.write(tmp_path)
    done = subprocess.run(["make", "build/libbare.a"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
