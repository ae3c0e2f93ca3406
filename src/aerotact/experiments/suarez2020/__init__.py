"""Experiments of suarez2020: one module an experiment; each offers its own in a constant `EXPERIMENTS`.

`flight_plan` says what the platform should do; `controllers` who flies it.
"""

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aerotact.experiments.experiment import Experiment


def _collected() -> "tuple[Experiment, ...]":
    modules = [importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__)]
    return tuple(found for module in modules for found in getattr(module, "EXPERIMENTS", ()))


EXPERIMENTS = _collected()
