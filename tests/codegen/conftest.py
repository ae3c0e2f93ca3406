"""A C compiler for small programs."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from aerotact.codegen.build import find_compiler


@pytest.fixture
def run_c(tmp_path: Path) -> Callable[..., str]:
    """Compile one C file with flags, run it, give back what it prints."""

    def run(source: str, *flags: str) -> str:
        (tmp_path / "a.c").write_text(source)
        command = [*find_compiler(), "-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic"]
        files = [str(tmp_path / "a.c"), "-lm", "-o", str(tmp_path / "a")]
        built = subprocess.run([*command, *flags, *files], capture_output=True, text=True, check=False)
        assert built.returncode == 0, built.stderr[:3000]
        return subprocess.run([str(tmp_path / "a")], capture_output=True, text=True, check=True).stdout

    return run
