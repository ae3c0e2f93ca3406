"""Generated projects build on their own, run their example, link nothing but libm and keep nothing writable."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.mpc.ocp import Ocp

# What a freestanding-minded library may ask of the C library.
ALLOWED = {
    *("memcpy", "memset", "memmove", "memcmp", "_GLOBAL_OFFSET_TABLE_"),
    *("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "pow", "fmin", "fmax", "hypot"),
    *("sinh", "cosh", "tanh", "log1p", "expm1", "fmod", "remainder", "floor", "ceil", "sincos"),
}
# Optimised lightly to save time; without what some distributions add by default.
CFLAGS = "-O1 -fno-stack-protector -U_FORTIFY_SOURCE"


def _run(folder: Path, *command: str) -> str:
    environment = {**os.environ, "CFLAGS": CFLAGS}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.returncode}\n{done.stdout}\n{done.stderr[:4000]}"
    return done.stdout


def _check(folder: Path, project: CProject) -> None:
    project.write(folder)
    printed = _run(folder, "make", "-s", "check")
    assert len(re.findall(rf"^{project.name}: \d+ steps, 0 not OK", printed, flags=re.MULTILINE)) == 2, printed
    objects = sorted((folder / "build").glob("*.o"))
    assert len(objects) == len(project.sources)
    for compiled in objects:
        for line in _run(folder, "nm", str(compiled)).splitlines():
            kind, symbol = line.split()[-2:]
            assert kind not in "bBdDC", f"{compiled.name}: writable {symbol}"
            if kind == "U":
                assert symbol in ALLOWED or symbol.startswith(f"{project.name}_"), f"{compiled.name}: needs {symbol}"


def test_block_makes_as_c_and_as_cpp(tmp_path: Path, block_c: CProject) -> None:
    _check(tmp_path, block_c)


def test_mpc_makes_as_c_and_as_cpp(tmp_path: Path, mpc_c: CProject) -> None:
    _check(tmp_path, mpc_c)


@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_law_passes_ctest(tmp_path: Path, block_c: CProject) -> None:
    block_c.write(tmp_path)
    _run(tmp_path, "cmake", "-B", "build", "-S", ".")
    _run(tmp_path, "cmake", "--build", "build")
    assert "100% tests passed" in _run(tmp_path, "ctest", "--test-dir", "build")


@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_mpc_passes_ctest(tmp_path: Path, hexarotor_ocp: Ocp) -> None:
    mpc_project(hexarotor_ocp).write(tmp_path)
    _run(tmp_path, "cmake", "-B", "build", "-S", ".", "-DCMAKE_BUILD_TYPE=Debug")
    _run(tmp_path, "cmake", "--build", "build")
    assert "100% tests passed" in _run(tmp_path, "ctest", "--test-dir", "build")
