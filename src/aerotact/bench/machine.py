"""Machine: where the numbers come from."""

import os
import platform
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from aerotact import __version__
from aerotact.codegen.build import compiler_version, find_compiler


def describe_machine() -> dict[str, Any]:
    """CPU, cores, system, load at the start, compiler, versions."""
    load = os.getloadavg() if hasattr(os, "getloadavg") else (float("nan"),)
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count() or 0,
        "system": f"{platform.system()} {platform.machine()}",
        "load": round(load[0], 1),
        "compiler": compiler_version(find_compiler()),
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "casadi": ca.CasadiMeta.version(),
            "aerotact": __version__,
        },
    }


def _cpu() -> str:
    """Model name, and the widest vectors it has."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    name = fields.get("model name", platform.machine())
    flags = fields.get("flags", "").split()
    vectors = next((label for flag, label in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags), "")
    family = f"family {fields['cpu family']} model {fields['model']}" if "cpu family" in fields else ""
    return ", ".join(part for part in (name, family, vectors) if part)
