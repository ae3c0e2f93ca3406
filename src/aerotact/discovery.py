"""Laws and estimators are found, not registered: every module of a package may offer builders in a named constant."""

import importlib
import pkgutil
from collections.abc import Callable

from aerotact.dynamics.model import Model
from aerotact.ports import Block

BlockMaker = Callable[[Model, float], Block]
"""From a robot's model and the rate in Hz at which the block will be called, to the block."""


def collect(package: str, constant: str) -> dict[str, BlockMaker]:
    """Builders by block name: the union of the dictionaries called `constant` in the modules of `package`.

    Raises:
        ValueError: two modules offer the same name.
    """
    found: dict[str, BlockMaker] = {}
    for info in pkgutil.iter_modules(importlib.import_module(package).__path__):
        module = importlib.import_module(f"{package}.{info.name}")
        offered: dict[str, BlockMaker] = getattr(module, constant, {})
        for name, maker in offered.items():
            if name in found:
                raise ValueError(f"{package}: '{name}' is offered twice, the second time by {info.name}")
            found[name] = maker
    return found
