import json
import subprocess
from pathlib import Path

import native
import numpy as np
import pytest

from aerotact.bench.problems import make_problem
from aerotact.codegen.build import find_compiler
from aerotact.codegen.project import CProject
from aerotact.codegen.rti_project import rti_project
from aerotact.exceptions import UnknownName

WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")
CALLER = """
#include <stdio.h>
#include "bench_h_rti.h"
static bench_h_rti rti;
int main(void)
{
    const double x[BENCH_H_NX] = {%s};
    const double stage[BENCH_H_NP] = {0.3, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
    bench_h_qp_settings settings;
    int i, k, status = 0;
    bench_h_rti_init(&rti);
    bench_h_qp_default_settings(&settings);
    bench_h_rti_start(&rti, x);
    for (k = 0; k <= BENCH_H_STEPS; ++k)
        for (i = 0; i < BENCH_H_NP; ++i)
            rti.stage[k][i] = stage[i];
    for (i = 0; i < 20; ++i) {
        bench_h_rti_prepare(&rti, NULL);
        status |= (int)bench_h_rti_feedback(&rti, x, &settings);
    }
    printf("%%d %%.17g", status, rti.x[BENCH_H_STEPS][0]);
    for (i = 0; i < BENCH_H_NU; ++i)
        printf(" %%.17g", rti.u[0][i]);
    return 0;
}
"""


@pytest.fixture(scope="module")
def project() -> CProject:
    return rti_project(make_problem("H", 5).transcription, doc="a short one")


@pytest.mark.parametrize(("language", "standard"), [("c", "c99"), ("c++", "c++11")])
def test_it_compiles_without_a_warning(project: CProject, tmp_path: Path, language: str, standard: str) -> None:
    project.write(tmp_path / "p")
    for source in project.sources:
        command = [*find_compiler(), "-x", language, f"-std={standard}", "-O1", *WARNINGS, "-Iinclude", "-Isrc"]
        done = subprocess.run(
            [*command, "-c", source, "-o", str(tmp_path / "a.o")],
            cwd=tmp_path / "p",
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr[:2000]


def test_its_makefile_builds_a_static_library(project: CProject, tmp_path: Path) -> None:
    project.write(tmp_path / "p")
    done = subprocess.run(
        ["make", "-C", str(tmp_path / "p"), "CFLAGS=-O0"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[:2000]
    assert (tmp_path / "p" / "build" / "libbench_h.a").stat().st_size > 0


def test_it_flies_to_the_reference_within_the_bounds(project: CProject, tmp_path: Path) -> None:
    problem = make_problem("H", 5)
    start = ", ".join(f"{v:.17g}" for v in problem.start)
    printed = native.run(tmp_path, project, CALLER % start).split()
    status, end, u = int(printed[0]), float(printed[1]), np.array(printed[2:], dtype=float)
    assert status == 0
    assert 0.0 < end <= 0.35
    assert u.shape == (6,)
    assert (np.abs(u) <= 60 * (1 + 1e-6)).all()


def test_the_manifest_tells_dimensions_and_the_bytes_do_not_change(project: CProject) -> None:
    assert project.manifest["sizes"] == {
        "steps": 5,
        "state": 19,
        "change": 18,
        "control": 6,
        "stage": 7,
        "parameters": 0,
        "bounded_states": 6,
    }
    again = rti_project(make_problem("H", 5).transcription, doc="a short one")
    assert again.files == project.files
    assert json.loads(project.files["manifest.json"])["kind"] == "rti"


def test_an_unknown_back_end_is_refused() -> None:
    with pytest.raises(UnknownName, match="rti_project"):
        rti_project(make_problem("H", 2).transcription, backend="none")
