"""The ocp file: one optimal control problem, validated."""

import math
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from aerotact.exceptions import ProblemError
from aerotact.resources import find_problem

Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Horizon(_Strict):
    """[problem]: what it needs, its grid and its rate.

    Attributes:
        doc: one line.
        needs: capabilities of the model.
        times: nodes of the horizon, s, from 0; the first interval is one period of the controller.
        steps, duration: a uniform grid instead of `times`.
        rate: Hz at which the controller runs.
        fallback: the law that takes over after `max_failures` failed steps.
        terminal: seconds by which the residuals of the last node count.
        delay: s from a measurement to the command that answers it, a whole number of periods.
        arms: of a robot that has some, those that are planned, that with the force first; None are all, that of
            the tool first.
    """

    doc: str = "model predictive controller"
    needs: list[str] = Field(default_factory=list)
    times: list[float] | None = None
    steps: int | None = Field(default=None, gt=0, le=500)
    duration: float | None = Field(default=None, gt=0)
    rate: float = Field(gt=0)
    fallback: str
    max_failures: int = Field(default=5, ge=0)
    terminal: float = Field(default=0.1, ge=0)
    delay: float = Field(default=0.0, ge=0, le=0.2)
    arms: list[str] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _one_grid(self) -> "Horizon":
        if (self.times is None) == (self.steps is None):
            raise ValueError("give either times, or steps and duration")
        if self.steps is not None and self.duration is None:
            raise ValueError("steps needs a duration")
        nodes = self.nodes
        if len(nodes) < 2 or nodes[0] != 0 or any(b <= a for a, b in pairwise(nodes)):
            raise ValueError("times must start at 0 and increase, with at least two nodes")
        if abs(nodes[1] * self.rate - 1) > 1e-9:
            raise ValueError(f"the first interval is {nodes[1]:g} s; it must be one period, {1 / self.rate:g} s")
        if abs(self.delay * self.rate - round(self.delay * self.rate)) > 1e-6:
            raise ValueError(
                f"delay is {self.delay:g} s; it must be a whole number of periods, {1 / self.rate:g} s each"
            )
        return self

    @property
    def delay_periods(self) -> int:
        """The delay in periods."""
        return round(self.delay * self.rate)

    @property
    def nodes(self) -> list[float]:
        """Nodes of the horizon, s."""
        if self.times is not None:
            return self.times
        assert self.steps is not None
        assert self.duration is not None
        return [self.duration * k / self.steps for k in range(self.steps + 1)]


class ResidualEntry(_Strict):
    """[residuals.<name>]: a weight, or weights by term; each a number or one number a coordinate."""

    weight: Weight | dict[str, Weight | list[Weight]]


class RowEntry(_Strict):
    """[constraints] <name> = { ... }: limits of a row, and how it may be violated.

    Attributes:
        soft: the quadratic penalty of a violation, or [linear, quadratic]; left out for a hard row.
        max, lower, upper: limits, as the row has them.
    """

    soft: Weight | Annotated[list[Weight], Field(min_length=2, max_length=2)] | None = None
    max: float | None = None
    lower: list[float] | None = None
    upper: list[float] | None = None

    @property
    def penalty(self) -> tuple[float, float]:
        """Linear and quadratic penalty; infinity and zero for a hard row."""
        if self.soft is None:
            return math.inf, 0.0
        return (self.soft[0], self.soft[1]) if isinstance(self.soft, list) else (0.0, self.soft)


class SolverEntry(_Strict):
    """[solver]: back end and settings."""

    backend: str = "aerotact"
    precision: Literal["double", "single"] = "double"
    levenberg_marquardt: float = Field(default=1e-6, ge=0)
    iterations: int = Field(default=1, ge=1)
    shift: bool = False
    startup_iterations: int = Field(default=5, ge=1)


class ProblemFile(_Strict):
    """The schema of an ocp file."""

    problem: Horizon
    residuals: dict[str, ResidualEntry] = Field(min_length=1)
    constraints: dict[str, Literal["hard"] | RowEntry] = Field(default_factory=dict)
    parameters: dict[str, float | list[float]] = Field(default_factory=dict)
    solver: SolverEntry = Field(default_factory=SolverEntry)


def load_problem(name_or_path: str | Path) -> tuple[Path, ProblemFile]:
    """Read and validate an ocp file.

    Raises:
        UnknownName: no such file or problem.
        ProblemError: names the file, the key, the fault and what would be valid.
    """
    path = find_problem(name_or_path)
    try:
        data = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ProblemError(path, "file", f"is not TOML: {error}", "mend the named line") from error
    try:
        return path, ProblemFile.model_validate(data)
    except ValidationError as error:
        first = max(error.errors(), key=lambda e: len(e["loc"]))  # of alternatives, the one that fits furthest
        key = ".".join(_key(data, first["loc"], missing=first["type"] == "missing"))
        given = "" if isinstance(first["input"], dict) else f" (got {first['input']!r})"
        remedy = "see docs/ocp.md for the keys and their ranges"
        if first["type"] == "extra_forbidden":
            remedy = f"valid: {', '.join(_keys_beside(first['loc']))}"
        raise ProblemError(path, key, f"{first['msg']}{given}", remedy) from error


def _key(data: Any, place: tuple[int | str, ...], *, missing: bool) -> list[str]:
    """The keys on the way to an error, without the names of alternative types that stand between them."""
    keys = []
    for part in place:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            continue
        keys.append(str(part))
    return [*keys, str(place[-1])] if missing else keys


def _keys_beside(place: tuple[int | str, ...]) -> list[str]:
    """Keys that the table of an unknown key may hold."""
    tables: dict[str, type[BaseModel]] = {
        "problem": Horizon,
        "residuals": ResidualEntry,
        "constraints": RowEntry,
        "solver": SolverEntry,
    }
    table = tables[str(place[0])] if len(place) > 1 else ProblemFile
    return sorted(table.model_fields)
