"""Footprint: the stack bound against call graphs made by hand and against painted memory; what the manifest says."""

import subprocess
from pathlib import Path

import pytest
from native import run

from aerotact.codegen import build
from aerotact.codegen.build import FLAGS, measured
from aerotact.codegen.footprint import worst_chain
from aerotact.codegen.functions import number
from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject
from aerotact.controller import Controller
from aerotact.mpc.ocp import Ocp

# The thread runs on memory that was painted; what it has overwritten is what it used. A thread that does nothing tells
# what threads themselves need.
PAINTED = """
#define _POSIX_C_SOURCE 200809L
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "{n}.h"

#define SIZE (1 << 20)
static {n}_workspace workspace;
static {n}_measurement measurement;
static {n}_reference reference;
static {n}_parameters parameters;
static {n}_output output;
static const double values[] = {{ {values} }};

static void *nothing(void *argument) {{ return argument; }}
static void *step(void *argument)
{{
    {n}_step(&workspace, &measurement, &reference, &parameters, &output);
    return argument;
}}

static long used(void *(*function)(void *))
{{
    pthread_attr_t attributes;
    pthread_t thread;
    void *stack;
    long i = 0;
    if (posix_memalign(&stack, 4096, SIZE) != 0)
        return -1;
    memset(stack, 0x5a, SIZE);
    pthread_attr_init(&attributes);
    pthread_attr_setstack(&attributes, stack, SIZE);
    pthread_create(&thread, &attributes, function, NULL);
    pthread_join(thread, NULL);
    while (i < SIZE && ((unsigned char *)stack)[i] == 0x5a)
        ++i;
    free(stack);
    return SIZE - i;
}}

int main(void)
{{
    {n}_init(&workspace);
    {n}_default_parameters(&parameters);
    {n}_default_reference(&reference);
    memcpy(&measurement, values, sizeof(measurement));
    printf("%ld\\n", used(step) - used(nothing));
    return workspace.statistics.status > 1;
}}
"""
SMALL = 512  # bytes; what alignment and the C library's own functions may add


def _node(name: str, size: int, kind: str = "static") -> str:
    return f'node: {{ title: "{name}" label: "{name}\\na.c:1:1\\n{size} bytes ({kind})" }}\n'


def _edge(caller: str, callee: str) -> str:
    return f'edge: {{ sourcename: "{caller}" targetname: "{callee}" label: "a.c:2:2" }}\n'


def test_worst_chain_goes_through_files() -> None:
    first = _node("step", 100) + _node("a.c:help", 30) + _edge("step", "a.c:help") + _edge("step", "solve")
    second = _node("solve", 500, "dynamic,bounded") + _edge("solve", "sin")
    assert worst_chain([first, second]) == 600
    assert worst_chain([first]) == 130
    assert worst_chain([]) is None


def test_recursion_and_growing_frames_have_no_bound() -> None:
    loop = _node("f", 10) + _node("g", 10) + _edge("f", "g") + _edge("g", "f")
    assert worst_chain([_node("h", 5), loop]) is None
    assert worst_chain([_node("f", 10, "dynamic")]) is None


def _check(folder: Path, project: CProject, machine_uses_gcc: bool) -> None:
    found = measured(project).manifest["footprint"]
    assert found["data_bytes"] == 0
    assert found["code_bytes"] > 1000
    if not machine_uses_gcc:
        assert found["stack_bytes"] is None
        return
    flags = tuple(f for f in FLAGS[1:] if not f.startswith("-W") and f != "-pedantic")
    values = ", ".join(map(number, Controller(project).flat("measurement").tolist()))
    printed = run(folder, project, PAINTED.format(n=project.name, values=values), (*flags, "-pthread", "-Wl,-z,now"))
    used = int(printed)
    assert 0.5 * found["stack_bytes"] < used < found["stack_bytes"] + SMALL


@pytest.fixture(scope="module")
def machine_uses_gcc() -> bool:
    done = subprocess.run([*build.find_compiler(), "--version"], capture_output=True, text=True, check=True)
    return "Free Software Foundation" in done.stdout


def test_block_stays_within_its_stack(tmp_path: Path, block_c: CProject, machine_uses_gcc: bool) -> None:
    _check(tmp_path, block_c, machine_uses_gcc)


def test_mpc_stays_within_its_stack(tmp_path: Path, hexarotor_ocp: Ocp, machine_uses_gcc: bool) -> None:
    _check(tmp_path, mpc_project(hexarotor_ocp), machine_uses_gcc)


def test_manifest_gains_the_footprint_and_keeps_the_rest(block_c: CProject) -> None:
    again, found = measured(block_c), measured(block_c).manifest
    assert dict(again.files) == dict(measured(block_c).files)
    footprint = found.pop("footprint")
    assert found == block_c.manifest
    assert footprint["workspace_bytes"] > 8 * block_c.manifest["sizes"]["output"]
    assert again.digest == block_c.digest


def test_make_size_names_sizes_and_frames(tmp_path: Path, block_c: CProject) -> None:
    block_c.write(tmp_path)
    printed = subprocess.run(["make", "-s", "size"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert "(TOTALS)" in printed
    assert f"{block_c.name}_step" in printed
