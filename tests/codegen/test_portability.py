"""The generated MPC on another processor (64-bit Arm, emulated) and under a memory checker."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.precision import in_single_precision
from aerotact.codegen.project import CProject
from aerotact.mpc.ocp import Ocp

STEPS = 40
# N, between processors: other rounding of libm, the same algorithm
AGREEMENT = {"double": 1e-7, "single": 1e-4}
ARM = ("aarch64-linux-gnu-gcc", "qemu-aarch64")

HARNESS = """
#include <math.h>
#include <stdio.h>
#include "{name}.h"
static {name}_workspace w;
int main(int argc, char **argv)
{{
    {name}_measurement y = {{0}};
    {name}_reference r;
    {name}_parameters p;
    {name}_output u;
    int k, i, bad = 0;
    (void)argv;
    {name}_init(&w);
    {name}_default_reference(&r);
    {name}_default_parameters(&p);
    for (k = 0; k < {steps}; ++k) {{
        y.p_WB[0] = 0.3 * sin(0.2 * k);
        y.p_WB[2] = {height} + 0.2 * cos(0.3 * k);
        y.q_WB[0] = 1.0;
        y.f_tool_W[0] = 3.0 * sin(0.1 * k);
        bad += {name}_step(&w, &y, &r, &p, &u) != 0;
        if (argc > 1)
            for (i = 0; i < {rotors}; ++i)
                printf("%.17g\\n", u.thrust_cmd[i]);
    }}
    return bad;
}}
"""


def _build(ocp: Ocp, project: CProject, folder: Path, compiler: str, *flags: str) -> Path:
    project.write(folder / "project")
    model = ocp.model
    text = HARNESS.format(name=ocp.name, steps=STEPS, height=model.hover_state[2], rotors=model.rotors)
    if project.manifest["precision"] == "single":
        text = in_single_precision(text)
    (folder / "project" / "harness.c").write_text(text)
    program = folder / compiler
    files = ["harness.c", *project.sources, "-lm", "-o", str(program)]
    command = [compiler, "-std=c99", "-O2", *flags, "-Wall", "-Wextra", "-Werror", "-Iinclude", "-Isrc", *files]
    built = subprocess.run(command, cwd=folder / "project", capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[:3000]
    return program


@pytest.mark.slow
@pytest.mark.skipif(any(shutil.which(t) is None for t in ARM), reason=f"needs {' and '.join(ARM)}")
@pytest.mark.parametrize("precision", AGREEMENT)
def test_arm_gives_the_same_commands(hexarotor_ocp: Ocp, tmp_path: Path, precision: str) -> None:
    project = mpc_project(hexarotor_ocp, precision)
    commands = []
    for compiler, run in (("cc", []), (ARM[0], [ARM[1]])):
        program = _build(hexarotor_ocp, project, tmp_path, compiler, *(["-static"] if run else []))
        done = subprocess.run([*run, str(program), "print"], capture_output=True, text=True, check=False)
        assert done.returncode == 0
        commands.append(np.array([float(v) for v in done.stdout.split()]))
    assert len(commands[0]) == STEPS * hexarotor_ocp.model.rotors
    np.testing.assert_allclose(commands[1], commands[0], rtol=0, atol=AGREEMENT[precision])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="needs valgrind")
def test_nothing_is_allocated(hexarotor_ocp: Ocp, tmp_path: Path) -> None:
    program = _build(hexarotor_ocp, mpc_project(hexarotor_ocp), tmp_path, "cc", "-g")
    command = ["valgrind", "--error-exitcode=99", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "total heap usage: 0 allocs, 0 frees, 0 bytes allocated" in done.stderr
