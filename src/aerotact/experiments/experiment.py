"""Experiment: a paper's experiment as data: cases, controllers, disturbances, metrics, the paper's own numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from aerotact.dynamics.model import Model
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance
from aerotact.ports import Array
from aerotact.reference import Reference

Parameters = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True)
class ControllerSpec:
    """A controller as an experiment flies it.

    Attributes:
        block: name of a law or of an ocp file.
        rate: Hz of a law; None for an ocp file, which has its own.
        parameters: that differ from the robot's or the problem's own.
        estimators: estimator -> parameters that differ from the robot's own.
        inner: controller that follows this one's outputs, by the names of its references; None if this one commands
            the robot itself.
        doc: one line on how it was tuned.
    """

    block: str
    rate: float | None
    doc: str
    parameters: Parameters = field(default_factory=dict)
    estimators: Mapping[str, Parameters] = field(default_factory=dict)
    inner: "ControllerSpec | None" = None

    @property
    def chain(self) -> tuple["ControllerSpec", ...]:
        """This controller and those inside of it, from the outermost on."""
        return (self, *self.inner.chain) if self.inner else (self,)


@dataclass(frozen=True)
class Case:
    """One run of an experiment.

    Attributes:
        name: short, fit for a file's name.
        doc: one line.
        duration: s.
        judged: start and stop in s of the part that metrics look at.
        parameters: of every controller, for this case; of nested ones, of those that have them.
        robot: name or folder of the robot of this case; None is the experiment's.
    """

    name: str
    doc: str
    duration: float
    judged: tuple[float, float]
    parameters: Parameters = field(default_factory=dict)
    robot: str | None = None


@dataclass(frozen=True)
class PaperNumber:
    """A number that the paper prints, and where."""

    value: float
    unit: str
    place: str


class Experiment(Protocol):
    """What a module of `aerotact.experiments` offers in its constant EXPERIMENTS, by name."""

    name: str
    doc: str
    robot: str
    world: str
    seeds: int
    cases: tuple[Case, ...]
    controllers: Mapping[str, ControllerSpec]
    paper: Mapping[str, PaperNumber]

    def reference(self, case: Case, model: Model) -> Reference:
        """What the tool should do."""

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """What acts on the plant. What differs from machine to machine is drawn by the seed of the run."""

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Metrics of the experiment's own, for one run; names end in the case's name where they are of one case."""

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Figures from the logs of one seed, (controller, case) -> columns; returns the files."""
