"""References: what is wanted over time, said beforehand or by an operator who decides as it goes."""

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from aerotact.controller import Controller
from aerotact.exceptions import LoopError
from aerotact.ports import Array, Port


class Reference(Protocol):
    """What is wanted over time."""

    def sample(self, times: Array) -> Mapping[str, Array]:
        """Signal -> array (len(times), size) for every reference port that it serves."""


@runtime_checkable
class Operator(Reference, Protocol):
    """A reference that decides as it goes: what it says of now and later may change with what it hears.

    Attributes:
        ports: signals that it serves for the log alone.
    """

    ports: Sequence[Port]

    def decide(self, time: float, heard: Mapping[str, Array]) -> None:
        """Hear, before each step of the outermost controller, what controllers could and where the world's objects are.

        Args:
            time: s.
            heard: measurements and estimates by name, and `objects_W` of `Plant.truth` if there are any.
        """


class ReferenceTable:
    """The references of one block at all its steps, sampled once; `without` are those that something else gives."""

    def __init__(
        self,
        block: Controller,
        reference: Reference,
        every: int,
        steps: int,
        dt: float,
        without: Collection[str] = (),
    ) -> None:
        self._every = every
        nodes = np.array(block.manifest.get("times_s", [0.0]))
        times: Array = np.arange(0, steps, every) * dt
        single = reference.sample(times)
        preview = reference.sample((times[:, None] + nodes).ravel()) if len(nodes) > 1 else single
        self._rows: list[tuple[Array, Array]] = []
        for name, view in block.reference.items():
            if name in without:
                continue
            source = preview if view.ndim > 1 else single
            if name not in source:
                raise LoopError(f"nothing serves the reference {name} of {block.name}; there is: {', '.join(source)}")
            self._rows.append((view, np.asarray(source[name]).reshape(len(times), *view.shape)))

    def write(self, k: int) -> None:
        """Put the values of physics step k into the block."""
        row = k // self._every
        for view, table in self._rows:
            view[:] = table[row]


class LiveReference:
    """The references of one block, asked of an operator at each of its steps."""

    def __init__(
        self,
        block: Controller,
        reference: Reference,
        every: int,
        steps: int,
        dt: float,
        without: Collection[str] = (),
    ) -> None:
        self._reference, self._dt = reference, dt
        self._nodes = np.array(block.manifest.get("times_s", [0.0]))
        self._views = {name: view for name, view in block.reference.items() if name not in without}
        served = reference.sample(np.zeros(1))
        for name in self._views:
            if name not in served:
                raise LoopError(f"nothing serves the reference {name} of {block.name}; there is: {', '.join(served)}")

    def write(self, k: int) -> None:
        """Put the values of physics step k into the block."""
        if self._views:
            said = self._reference.sample(k * self._dt + self._nodes)
            for name, view in self._views.items():
                view[:] = said[name] if view.ndim > 1 else said[name][0]
