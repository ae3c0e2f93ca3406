"""Schedule: signals that are at rest but where they are told to step or to run from one value to the next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from aerotact.ports import Array, Layout

Way = Sequence[tuple[float, Any]]
"""Times, s, increasing, and the value from then on: one number, or one for each component."""


@dataclass(frozen=True)
class Schedule:
    """Signals over time.

    Attributes:
        rest: ports whose defaults hold for signals that no way names.
        steps: signal -> way on which it jumps.
        ramps: signal -> way on which it runs straight from each value to the next; held before and after.
    """

    rest: Layout
    steps: Mapping[str, Way] = field(default_factory=dict)
    ramps: Mapping[str, Way] = field(default_factory=dict)

    def sample(self, times: Array) -> dict[str, Array]:
        """Signal -> array (len(times), size)."""
        values = {port.name: np.tile(port.default, (len(times), 1)) for port in self.rest}
        for name, way in self.steps.items():
            for start, value in way:
                values[name][times >= start - 1e-9] = value
        for name, way in self.ramps.items():
            knots = np.array([np.broadcast_to(value, values[name].shape[1]) for _, value in way], dtype=float)
            at = [time for time, _ in way]
            values[name] = np.column_stack([np.interp(times, at, column) for column in knots.T])
        return values
