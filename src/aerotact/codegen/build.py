"""C project -> shared library and its footprint, compiled once per content and kept in a cache."""

import ctypes
import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

from aerotact.codegen.footprint import CALL_GRAPH, Footprint, code_and_data, worst_chain
from aerotact.codegen.linked import Library, compile_flags, find_library, link_flags
from aerotact.codegen.project import MANIFEST, CProject
from aerotact.exceptions import CodegenError, CompilerNotFound

FLAGS = ("-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-pedantic")
_CANDIDATES = ("cc", "gcc", "clang")


def find_compiler() -> list[str]:
    """The C compiler: $CC, else cc, gcc or clang, as a command line.

    Raises:
        CompilerNotFound: there is none.
    """
    chosen = os.environ.get("CC")
    tried = (chosen,) if chosen else _CANDIDATES
    for candidate in tried:
        try:
            words = shlex.split(candidate)
        except ValueError:  # a quotation mark too few
            continue
        if words and shutil.which(words[0]):
            return words
    raise CompilerNotFound(tried)


def compiler_version(compiler: list[str]) -> str:
    """First line that it says of itself; its command line if it says nothing."""
    try:
        done = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return " ".join(compiler)
    return done.stdout.splitlines()[0]


def cache_folder() -> Path:
    """Where compiled libraries are kept: $AEROTACT_CACHE, else $XDG_CACHE_HOME/aerotact, else ~/.cache/aerotact."""
    chosen = os.environ.get("AEROTACT_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aerotact"


def compile_library(project: CProject, flags: tuple[str, ...] = FLAGS, cache: Path | None = None) -> Path:
    """Shared library of the project; compiled if the cache has none of the same content, compiler, flags and machine.

    Args:
        project: to compile.
        flags: of the compiler.
        cache: folder of compiled libraries; `cache_folder()` if None.

    Raises:
        CompilerNotFound: no C compiler.
        LibraryNotFound: the project links a library that is not here.
        CodegenError: the compiler failed (the message has its first lines), or the cache cannot be written.
    """
    compiler = find_compiler()
    linked = [find_library(name) for name in project.linked]
    parts = [project.digest, *compiler, *flags, *link_flags(linked), _processor()]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]
    library = (cache or cache_folder()) / f"{project.name}-{key}.so"
    if library.is_file() and _report(library).is_file():
        return library
    _make_folder(library.parent)
    with tempfile.TemporaryDirectory(prefix="aerotact-") as scratch:
        root = Path(scratch)
        project.write(root / "project")
        built = root / library.name
        found = _build(project, root, compiler, flags, linked, built)
        # A rename within the cache is atomic, so that two processes may build the same library.
        for target, content in ((_report(library), found.encode()), (library, built.read_bytes())):
            partial = target.with_name(f"{target.name}.{os.getpid()}.part")
            partial.write_bytes(content)
            partial.replace(target)
    return library


def measured(project: CProject, cache: Path | None = None) -> CProject:
    """The project with its footprint, as compiled here with FLAGS, in manifest.json.

    Raises:
        CompilerNotFound, CodegenError: as compile_library.
    """
    library = compile_library(project, cache=cache)
    found = Footprint(**json.loads(_report(library).read_text()))
    size = getattr(ctypes.CDLL(str(library)), f"{project.name}_workspace_size", None)
    if size is not None:
        size.restype = ctypes.c_size_t
        found = replace(found, workspace_bytes=int(size()))
    content = {**project.manifest, "footprint": asdict(found)}
    text = json.dumps(content, indent=2, sort_keys=True) + "\n"
    return replace(project, files={**project.files, MANIFEST: text})


def _build(
    project: CProject, root: Path, compiler: list[str], flags: tuple[str, ...], linked: list[Library], built: Path
) -> str:
    """Compile every file, all processors at work, and link; gives the footprint as JSON."""
    version = compiler_version(compiler)
    graph = [CALL_GRAPH] if _has_call_graph(compiler, root) else []
    quiet = [*(f for f in flags if not f.startswith("-W") and f != "-pedantic"), "-w"]
    includes = ["-Iinclude", "-Isrc", *compile_flags(linked)]
    jobs = [
        *([*compiler, *flags, *graph, "-fPIC", *includes, "-c", p] for p in project.sources),
        *([*compiler, *quiet, *graph, "-fPIC", "-c", p] for p in project.third_party),
    ]
    jobs.sort(key=lambda job: len(project.files[job[-1]]), reverse=True)  # the longest first
    objects = [f"{number}.o" for number in range(len(jobs))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda job, o: _compile(project, root, [*job, "-o", o]), jobs, objects))
    _compile(project, root, [*compiler, *flags, "-shared", *objects, *link_flags(linked), "-lm", "-o", str(built)])
    made = [root / "project" / o for o in objects]
    code, data = code_and_data(*made) or (None, None)
    graphs = [o.with_suffix(".ci").read_text() for o in made] if graph else []
    words = " ".join([version, *flags[:4]])
    return json.dumps(asdict(Footprint(code, data, None, worst_chain(graphs), words, platform.machine())))


def _has_call_graph(compiler: list[str], root: Path) -> bool:
    (root / "empty.c").write_text("")
    command = [*compiler, CALL_GRAPH, "-c", "empty.c", "-o", "empty.o"]
    return subprocess.run(command, cwd=root, capture_output=True, check=False).returncode == 0


def _report(library: Path) -> Path:
    """Where a library's footprint is kept."""
    return library.with_suffix(".json")


def _compile(project: CProject, root: Path, command: list[str]) -> None:
    done = subprocess.run(command, cwd=root / "project", capture_output=True, text=True, check=False)
    if done.returncode:
        first = "\n".join(done.stderr.splitlines()[:12])
        raise CodegenError(f"{project.name}: {shlex.join(command)} failed with {done.returncode}:\n{first}")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CodegenError(
            f"cache {folder}: cannot be made: {error}; set AEROTACT_CACHE to a folder that you can write"
        ) from error
    if not os.access(folder, os.W_OK):
        raise CodegenError(f"cache {folder}: is not writable; set AEROTACT_CACHE to a folder that you can write")


def _processor() -> str:
    """What -march=native depends on."""
    try:
        flags = next(
            line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Features"))
        )
    except (OSError, StopIteration):
        flags = platform.processor()
    return f"{platform.machine()} {flags}"
