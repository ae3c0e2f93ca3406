"""Footprint: bytes of code, data, workspace and stack that a C project takes, as one compiler makes it."""

import re
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

CALL_GRAPH = "-fcallgraph-info=su"
"""Makes gcc write <object>.ci: who calls whom, and the stack frame of each function."""

_NODE = re.compile(r'^node: \{ title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \(([^)]+)\)', re.MULTILINE)
_EDGE = re.compile(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class Footprint:
    """What a library takes on one target.

    Attributes:
        code_bytes: machine code and constants; None where there is no program `size`.
        data_bytes: variables; None likewise.
        workspace_bytes: what the caller provides; None if the library has no such function.
        stack_bytes: frames of the worst call chain inside the library, without the C library and without what the
            caller hands in (a clock); None where the compiler writes no call graph, or there is no bound.
        compiler: its first line of `--version`, and its flags.
        machine: the target.
    """

    code_bytes: int | None
    data_bytes: int | None
    workspace_bytes: int | None
    stack_bytes: int | None
    compiler: str
    machine: str


def code_and_data(*files: Path) -> tuple[int, int] | None:
    """Bytes of code with constants, and of variables, as `size` counts them; None where there is no such program."""
    try:
        listed = subprocess.run(["size", *map(str, files)], check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    rows = [[int(word) for word in line.split()[:3]] for line in listed.splitlines()[1:]]
    return sum(row[0] for row in rows), sum(row[1] + row[2] for row in rows)


def worst_chain(graphs: Iterable[str]) -> int | None:
    """Bytes of stack of the worst call chain in gcc's call graphs; None if there is none, or no bound.

    Functions without a frame size are outside the library and count nothing.
    """
    frames: dict[str, int] = {}
    callees: dict[str, set[str]] = {}
    for text in graphs:
        for name, size, kind in _NODE.findall(text):
            if kind == "dynamic":  # a frame that grows with its data
                return None
            frames[name] = int(size)
        for caller, callee in _EDGE.findall(text):
            callees.setdefault(caller, set()).add(callee)
    depth: dict[str, int | None] = {}

    def below(name: str) -> int | None:
        if name not in depth:
            depth[name] = None  # met again before it is known: recursion
            chains = [below(callee) for callee in callees.get(name, ()) if callee in frames]
            deep = [chain for chain in chains if chain is not None]
            if len(deep) == len(chains):
                depth[name] = frames[name] + max(deep, default=0)
        return depth[name]

    found = [below(name) for name in frames]
    deepest = [chain for chain in found if chain is not None]
    return max(deepest) if deepest and len(deepest) == len(found) else None
