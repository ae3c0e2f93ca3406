"""Block -> C project: every file of it, as text; the same input gives the same bytes."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import mujoco

from aerotact import __version__
from aerotact.codegen.example import SECONDS, Example, make_example
from aerotact.codegen.functions import emit, number, signature
from aerotact.codegen.precision import files_in_single_precision
from aerotact.codegen.templating import templates
from aerotact.dynamics.model import Model
from aerotact.exceptions import CodegenError
from aerotact.ports import Block, Layout, Port
from aerotact.robot import Robot

MAX_FAILURES = 10
MANIFEST = "manifest.json"
THIRD_PARTY = "third_party/"
_GROUPS = {
    "measurement": "What was measured.",
    "reference": "What is wanted.",
    "parameters": "Gains and constants; change them whenever you like.",
    "output": "What comes out.",
}


@dataclass(frozen=True)
class CProject:
    """A generated C project, not yet written.

    Attributes:
        name: prefix of everything in it.
        files: path inside the project -> text.
        sources: our C files of the library, inside the project.
        linked: libraries that the machine must have, by the names of codegen/linked.py.
    """

    name: str
    files: Mapping[str, str]
    sources: tuple[str, ...]
    linked: tuple[str, ...] = ()

    @property
    def manifest(self) -> dict[str, Any]:
        """The parsed manifest.json."""
        return dict(json.loads(self.files[MANIFEST]))

    @property
    def third_party(self) -> tuple[str, ...]:
        """C files of the library that others wrote: compiled as C, without our warnings."""
        return tuple(p for p in self.files if p.startswith(THIRD_PARTY) and p.endswith(".c"))

    @property
    def digest(self) -> str:
        """Hash of every byte of the library (not of the example or the texts)."""
        sha = hashlib.sha256()
        for path in sorted(self.files):
            if path.startswith(("include/", "src/", THIRD_PARTY)):
                sha.update(path.encode() + b"\0" + self.files[path].encode() + b"\0")
        return sha.hexdigest()

    def write(self, folder: Path) -> None:
        """Write into `folder`, which is made; an older generated project there is replaced.

        Raises:
            CodegenError: the folder holds something that is no generated project, or cannot be written.
        """
        try:
            if folder.exists() and any(folder.iterdir()):
                if not _is_generated(folder):
                    raise CodegenError(
                        f"{folder}: is not empty and holds no {MANIFEST} of aerotact; "
                        "valid: a new folder, or a generated project"
                    )
                for part in ("include", "src", "third_party", "example", "build"):
                    shutil.rmtree(folder / part, ignore_errors=True)
            for path, text in self.files.items():
                target = folder / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(text)
        except OSError as error:
            raise CodegenError(f"{folder}: cannot be written: {error}; valid: a folder that you own") from error


def _is_generated(folder: Path) -> bool:
    """Whether the folder holds an older generated project, which may be replaced."""
    try:
        content = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError):
        return False
    versions = content.get("versions") if isinstance(content, dict) else None
    return isinstance(versions, dict) and "aerotact" in versions


def comment(text: str) -> str:
    """Text that can stand inside a C comment: one line, without its end mark."""
    return " ".join(text.replace("*/", "* /").split())


def _port_context(port: Port, start: int) -> dict[str, Any]:
    frame = f", {port.frame}" if port.frame else ""
    doc = f": {comment(port.doc)}" if port.doc else ""
    return {
        "name": port.name,
        "size": port.size,
        "nodes": port.nodes,
        "kind": port.kind,
        "start": start,
        "lower": number(max(-port.limit, port.lower)),
        "upper": number(port.limit),
        "comment": f"{port.unit}{frame}{doc}",
    }


def _group_context(title: str, layout: Layout) -> dict[str, Any]:
    return {
        "title": title,
        "doc": _GROUPS[title],
        "input": title != "output",
        "size": layout.size,
        "ports": [_port_context(p, layout.slice(p.name).start) for p in layout],
        "default": [number(v) for v in layout.default.tolist()],
    }


def block_context(block: Block, robot: Robot) -> dict[str, Any]:
    """What the templates know of a block."""
    return {
        "name": block.name,
        "NAME": block.name.upper(),
        "doc": comment(block.doc),
        "source": block.source,
        "robot": comment(robot.name),
        "rate": f"{block.rate:g}",
        "rate_literal": number(block.rate),
        "version": __version__,
        "groups": [_group_context(title, getattr(block, title)) for title in _GROUPS],
        "state_size": block.state.size,
        "state_default": [number(v) for v in block.state.default.tolist()],
        "output_size": block.output.size,
        "limited": block.limiter is not None,
        "limiter_size": block.limiter_state.size,
        "limiter_default": [number(v) for v in block.limiter_state.default.tolist()],
        "command_size": block.limiter.size1_out(1) if block.limiter is not None else 0,
        "max_failures": MAX_FAILURES,
        "seconds": f"{SECONDS:g}",
        "mpc": None,
        "caveat": "",
        "precision": "double",
    }


def manifest(block: Block, robot: Robot, extra: Mapping[str, Any]) -> str:
    """Ports, dimensions, hashes of the inputs and versions, as JSON with sorted keys."""
    layouts = {t: getattr(block, t) for t in _GROUPS}
    content = {
        "name": block.name,
        "source": block.source,
        "rate_hz": block.rate,
        "robot": robot.name,
        "inputs": {f: hashlib.sha256((robot.folder / f).read_bytes()).hexdigest() for f in ("plant.xml", "robot.toml")},
        "versions": {"aerotact": __version__, "casadi": ca.CasadiMeta.version(), "mujoco": mujoco.mj_versionString()},
        "sizes": {t: layout.size for t, layout in layouts.items()},
        "ports": {
            t: [
                {"name": p.name, "size": p.size, "nodes": p.nodes, "unit": p.unit, "frame": p.frame, "kind": p.kind}
                for p in layout
            ]
            for t, layout in layouts.items()
        },
        **extra,
    }
    return json.dumps(content, indent=2, sort_keys=True) + "\n"


def function_files(name: str, functions: list[tuple[Any, str, list[str], list[str]]]) -> dict[str, str]:
    """`src/<name>_functions.h` and `.c`: (CasADi function, C name, arguments, results)."""
    heads = [signature(n, a, r) for _, n, a, r in functions]
    header = templates().get_template("functions.h.jinja").render(name=name, NAME=name.upper(), signatures=heads)
    body = [emit(f, n, a, r, lambda n: f"/* {n} */") for f, n, a, r in functions]
    return {
        f"src/{name}_functions.h": header,
        f"src/{name}_functions.c": "\n".join([f'#include "{name}_functions.h"\n\n#include <math.h>\n', *body]),
    }


def assemble(
    context: Mapping[str, Any],
    functions: list[tuple[Any, str, list[str], list[str]]],
    example: Example,
    main: str,
    manifest_text: str,
    extra_sources: Mapping[str, str],
) -> CProject:
    """Render the files that every project has around its own `src/<name>.c`, made from template `main`."""
    environment = templates()
    name = str(context["name"])
    extra = [p for p in extra_sources if p.endswith(".c")]
    sources = (f"src/{name}.c", f"src/{name}_functions.c", *[p for p in extra if not p.startswith(THIRD_PARTY)])
    foreign = [p for p in extra if p.startswith(THIRD_PARTY)]
    full = {"linked": [], **context, "plant": example.context, "sources": sources, "third_party": foreign}

    def render(template: str) -> str:
        return environment.get_template(template).render(full)

    files = {
        f"include/{name}.h": render("api.h.jinja"),
        f"src/{name}.c": render(main),
        **function_files(name, functions),
        **extra_sources,
        "example/main.c": render("main.c.jinja"),
        f"example/{name}_plant.h": example.header,
        f"example/{name}_plant.c": example.source,
        "Makefile": render("Makefile.jinja"),
        "CMakeLists.txt": render("CMakeLists.txt.jinja"),
        "README.md": render("README.md.jinja"),
        MANIFEST: manifest_text,
    }
    return CProject(name, files, sources, tuple(library["name"] for library in full["linked"]))


def in_single_precision(project: CProject) -> CProject:
    """The project with floats instead of doubles, in its interface too."""
    return replace(project, files=files_in_single_precision(project.files))


def limit_function(limiter: Any) -> Any:
    """The limiter's step without its empty reference and parameters."""
    z, wanted = limiter.sx_in(0), limiter.sx_in(1)
    return ca.Function("limit", [z, wanted], limiter(z, wanted, ca.SX(0, 1), ca.SX(0, 1)))


def block_project(block: Block, model: Model, precision: str = "double") -> CProject:
    """The C project of a law or an estimator; `precision` is "double", or "single" for floats."""
    context = {**block_context(block, model.robot), "precision": precision}
    functions = [(block.step, f"{block.name}_law", ["z", "y", "r", "p"], ["z_next", "u"])]
    if block.limiter is not None:
        functions.append((limit_function(block.limiter), f"{block.name}_limit", ["z", "wanted"], ["z_next", "u"]))
    example = make_example(
        block.name, model, block.rate, block.measurement, block.reference, block.output, block.limiter is not None
    )
    text = manifest(block, model.robot, {"precision": precision})
    project = assemble(context, functions, example, "block.c.jinja", text, {})
    return in_single_precision(project) if precision == "single" else project
