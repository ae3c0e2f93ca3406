"""Peer: a solver in the race, and what it answers."""

from dataclasses import dataclass, field
from typing import Protocol

from aerotact.bench.qp import Qp, Solution
from aerotact.bench.scenario import Sample
from aerotact.ports import Array


class Absent(Exception):
    """A peer that cannot race here; the message is the one line that says why."""


@dataclass(frozen=True)
class Answer:
    """To one sample.

    Attributes:
        u0: first control, shape (nu,).
        prepare, feedback: microseconds before and after the measurement is known; NaN where they are one.
        total: microseconds.
        usable: the solver says that its answer can be used.
        solution: changes and multipliers, of the common Qp if `own` is None, else of `own`; None if there are none.
        own: the solver's own Qp, where its coordinates are not the common ones.
        parts: further times, microseconds, by name.
        work: factorisations of the horizon, partial ones included; NaN where not known.
    """

    u0: Array
    prepare: float
    feedback: float
    total: float
    usable: bool
    solution: Solution | None = None
    own: Qp | None = None
    parts: dict[str, float] = field(default_factory=dict)
    work: float = float("nan")


class Peer(Protocol):
    """What `run` calls.

    Attributes:
        name: row of the table.
        settings: what was chosen, one line.
        versions: of what it is made of.
        every: it sees each sample if 1, each tenth if 10: for the slow ones.
        build_seconds: generating and compiling.
        sizes: bytes, by name, where known.
    """

    name: str
    settings: str
    versions: dict[str, str]
    every: int
    build_seconds: float
    sizes: dict[str, int]

    def reset(self) -> None:
        """Forget the past."""
        ...

    def solve(self, sample: Sample, full: bool = True) -> Answer:
        """One iteration from the sample's trajectory; with `full` the answer holds its solution and its own Qp."""
        ...
