"""Compiling: found compiler, cache, and what is said when either is missing or spoilt."""

import os
import stat
from pathlib import Path
from typing import Any

import pytest

from aerotact.codegen import build
from aerotact.codegen.build import cache_folder, compile_library, find_compiler
from aerotact.codegen.project import CProject, block_project
from aerotact.controller import Controller
from aerotact.dynamics.model import Model
from aerotact.exceptions import CodegenError, CompilerNotFound
from aerotact.laws import laws


@pytest.fixture
def law_c(hexarotor: Model) -> CProject:
    return block_project(laws()["ryll2019_pose_control"](hexarotor, 500.0), hexarotor)


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("AEROTACT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_no_compiler_in_path(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, law_c: CProject) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(CompilerNotFound, match=r"tried cc, gcc, clang\); install gcc or clang"):
        compile_library(law_c)
    assert not empty_cache.exists()


@pytest.mark.parametrize("nonsense", ["no-such-compiler", "'", " "])
def test_cc_that_is_no_compiler(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, law_c: CProject, nonsense: str
) -> None:
    monkeypatch.setenv("CC", nonsense)
    with pytest.raises(CompilerNotFound, match="no C compiler found"):
        Controller(law_c)


def test_cc_may_carry_options(monkeypatch: pytest.MonkeyPatch) -> None:
    (compiler,) = find_compiler()
    monkeypatch.setenv("CC", f"{compiler} -g0")
    assert find_compiler() == [compiler, "-g0"]


def test_compiler_that_fails_is_quoted(empty_cache: Path, law_c: CProject) -> None:
    source = f"src/{law_c.name}.c"
    broken = CProject(law_c.name, {**law_c.files, source: law_c.files[source] + "int 5;\n"}, law_c.sources)
    with pytest.raises(CodegenError, match=rf"{law_c.name}: .*failed with 1:\n.*{law_c.name}\.c.*error"):
        compile_library(broken)
    assert list(empty_cache.glob("*")) == []


def test_second_controller_does_not_compile(
    empty_cache: Path, law_c: CProject, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Controller(law_c)

    def refuse(*args: object, **rest: object) -> None:
        raise AssertionError("the compiler ran again")

    monkeypatch.setattr(build.subprocess, "run", refuse)
    second = Controller(law_c)
    assert first.library == second.library
    assert {p.name for p in empty_cache.iterdir()} == {first.library.name, first.library.with_suffix(".json").name}
    changed = CProject(law_c.name, {**law_c.files, "src/new.h": "\n"}, law_c.sources)
    with pytest.raises(AssertionError, match="ran again"):
        Controller(changed)


def test_every_file_is_compiled_once(empty_cache: Path, law_c: CProject, monkeypatch: pytest.MonkeyPatch) -> None:
    run, commands = build.subprocess.run, []

    def watch(command: list[str], **rest: Any) -> Any:
        commands.append(command)
        return run(command, **rest)

    monkeypatch.setattr(build.subprocess, "run", watch)
    compile_library(law_c)
    compiled = [word for command in commands for word in command if word.endswith(".c") and word != "empty.c"]
    assert sorted(compiled) == sorted(law_c.sources)


def test_other_flags_are_another_library(empty_cache: Path, law_c: CProject) -> None:
    assert compile_library(law_c) != compile_library(law_c, (*build.FLAGS, "-g0"))


@pytest.mark.parametrize("content", [b"", b"no library"], ids=["empty", "text"])
def test_spoilt_library_names_the_file_to_delete(empty_cache: Path, law_c: CProject, content: bytes) -> None:
    library = compile_library(law_c)
    library.unlink()
    library.write_bytes(content)
    with pytest.raises(CodegenError, match=rf"{library.name}: cannot be loaded: .*delete it and run again"):
        Controller(law_c)
    library.unlink()
    assert Controller(law_c).step() == 0


def test_library_of_something_else_names_the_file_to_delete(
    empty_cache: Path, law_c: CProject, hexarotor: Model
) -> None:
    other = compile_library(block_project(laws()["ryll2019_admittance_filter"](hexarotor, 500.0), hexarotor))
    library = compile_library(law_c)
    library.unlink()
    library.write_bytes(other.read_bytes())
    with pytest.raises(CodegenError, match=rf"{library.name}: .*{law_c.name}_\w+.*delete it and run again"):
        Controller(law_c)


def test_cache_that_cannot_be_made_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, law_c: CProject) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("AEROTACT_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(CodegenError, match=r"cache .*file/cache: cannot be made: .*set AEROTACT_CACHE"):
        compile_library(law_c)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_cache_that_cannot_be_written_is_named(empty_cache: Path, law_c: CProject) -> None:
    empty_cache.mkdir()
    empty_cache.chmod(stat.S_IREAD | stat.S_IEXEC)
    with pytest.raises(CodegenError, match=r"cache .*: is not writable; set AEROTACT_CACHE"):
        compile_library(law_c)


def test_cache_folder_order(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("AEROTACT_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.delenv("AEROTACT_CACHE")
    assert cache_folder() == tmp_path / "xdg" / "aerotact"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "aerotact"
