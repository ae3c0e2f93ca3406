"""The same problems through every vector width: equal up to rounding. Strict C99 and C++11."""

import platform
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from problems import random_problem
from shapes import Shape
from solver import WARNINGS, Answer, Solver, Status, write_solver

from aerotact.codegen.build import find_compiler

WIDTHS = {
    "avx512f": ("-O2", "-mavx512f", "-mavx2", "-mfma"),
    "avx2": ("-O2", "-mavx2", "-mfma"),
    "sse2": ("-O2",),
    "scalar": ("-O2", "-U__SSE2__"),
}
AGREEMENT = 1e-7  # of controls of the size of one
PROBLEMS = 42


def _answers(folder: Path, shape: Shape, flags: tuple[str, ...]) -> list[Answer]:
    rng, solver = np.random.default_rng(1), Solver(folder, shape.pattern, flags)
    kinds = ("plain", "tight", "saturated")
    return [solver.solve(random_problem(rng, shape, kinds[i % len(kinds)]), cold=False) for i in range(PROBLEMS)]


def _supported(width: str) -> bool:
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").is_file() else ""
    return width in ("sse2", "scalar") or width in flags


@pytest.mark.skipif(platform.machine() != "x86_64", reason="x86-64 only")
def test_every_width_gives_the_same(tmp_path: Path, mixed: Shape) -> None:
    expected = _answers(tmp_path / "native", mixed, ("-O3", "-march=native"))
    assert all(answer.status == Status.OK for answer in expected)
    for width, flags in WIDTHS.items():
        if not _supported(width):
            continue
        for got, wanted in zip(_answers(tmp_path / width, mixed, flags), expected, strict=True):
            assert got.status == wanted.status
            np.testing.assert_allclose(got.u, wanted.u, rtol=0.0, atol=AGREEMENT, err_msg=width)


@pytest.mark.parametrize("width", ["native", "scalar"])
def test_strict_languages(tmp_path: Path, mixed: Shape, width: str) -> None:
    source = write_solver(tmp_path, mixed.pattern)
    flags = (*WARNINGS, f"-I{tmp_path}/include", *WIDTHS.get(width, ("-O2", "-march=native")), "-c", str(source))
    subprocess.run([*find_compiler(), "-std=c99", *flags, "-o", str(tmp_path / "c.o")], check=True)
    if shutil.which("g++"):
        subprocess.run(["g++", "-x", "c++", "-std=c++11", *flags, "-o", str(tmp_path / "cpp.o")], check=True)


def test_same_text_every_time(tmp_path: Path, mixed: Shape) -> None:
    texts = [write_solver(tmp_path / name, mixed.pattern).read_bytes() for name in ("once", "again")]
    assert texts[0] == texts[1]
