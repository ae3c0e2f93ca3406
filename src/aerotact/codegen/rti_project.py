"""Transcription -> C project of its real-time iteration alone: for those who bring their own loop around it."""

import json

import casadi as ca

from aerotact import __version__
from aerotact.codegen.backends import BACKENDS
from aerotact.codegen.linked import linked_context
from aerotact.codegen.precision import files_in_single_precision
from aerotact.codegen.project import MANIFEST, THIRD_PARTY, CProject, function_files
from aerotact.codegen.rti_sources import rti_sources
from aerotact.codegen.templating import templates
from aerotact.mpc.transcription import Transcription


def rti_project(
    transcription: Transcription, backend: str = "aerotact", doc: str = "", precision: str = "double"
) -> CProject:
    """The bare solver: `include/<name>_rti.h`, its sources, a Makefile for a static library, manifest and README.

    Args:
        transcription: of the problem; its statement's name is the C prefix.
        backend: who solves the quadratic programme.
        doc: one line for the README.
        precision: "double", or "single" for floats.

    Raises:
        UnknownName: there is no such back end.
        CodegenError: an operation that C lacks.
    """
    s = transcription.statement
    rti = rti_sources(transcription, backend, "rti_project", precision)
    written = [path for path in rti.files if path.endswith(".c")]
    sources = (f"src/{s.name}_functions.c", *[path for path in written if not path.startswith(THIRD_PARTY)])
    context = {
        "name": s.name,
        "NAME": s.name.upper(),
        "doc": " ".join(doc.split()) or "Real-time iteration of an optimal control problem",
        "rti": rti.context,
        "parameter_size": s.parameter_size,
        "sources": sources,
        "third_party": [path for path in written if path.startswith(THIRD_PARTY)],
        "linked": linked_context(BACKENDS[backend].linked),
    }
    manifest = {
        "name": s.name,
        "kind": "rti",
        "backend": backend,
        "precision": precision,
        "versions": {"aerotact": __version__, "casadi": ca.CasadiMeta.version()},
        "times_s": [float(t) for t in s.times],
        "sizes": {
            "steps": transcription.steps,
            "state": s.nx,
            "change": s.ndx,
            "control": s.nu,
            "stage": s.stage_size,
            "parameters": s.parameter_size,
            "bounded_states": len(s.bounds.states),
        },
    }
    environment = templates()
    functions = function_files(s.name, rti.functions)
    files = {
        **rti.files,
        **(files_in_single_precision(functions) if precision == "single" else functions),
        "Makefile": environment.get_template("rti_Makefile.jinja").render(context),
        "README.md": environment.get_template("rti_README.md.jinja").render(context),
        MANIFEST: json.dumps(manifest, indent=2, sort_keys=True) + "\n",
    }
    return CProject(s.name, files, sources, BACKENDS[backend].linked)
