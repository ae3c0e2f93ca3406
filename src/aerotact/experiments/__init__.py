"""The papers' experiments: one module a paper; each offers its experiments in a constant `EXPERIMENTS`."""

import importlib
import pkgutil
from typing import TYPE_CHECKING

from aerotact.exceptions import UnknownName

if TYPE_CHECKING:
    from aerotact.experiments.experiment import Experiment


def experiments() -> "dict[str, Experiment]":
    """Every experiment by its name, paper/experiment."""
    found: dict[str, Experiment] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for experiment in getattr(module, "EXPERIMENTS", ()):
            found[experiment.name] = experiment
    return found


def find_experiment(name: str) -> "Experiment":
    """An experiment by name.

    Raises:
        UnknownName: there is none of that name.
    """
    found = experiments()
    if name not in found:
        raise UnknownName("experiment", name, found)
    return found[name]
