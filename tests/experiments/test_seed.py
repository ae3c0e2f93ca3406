"""A run's seed reaches the disturbances of its experiment, so that errors of the plant can be drawn by it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case
from aerotact.experiments.ryll2019 import FreeFlight
from aerotact.flight import fly
from aerotact.plant.disturbance import Disturbance, ToolForce


@dataclass(frozen=True)
class Pulled(FreeFlight):
    """The tool is pulled with as many newtons as the seed says."""

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        return [ToolForce((float(seed), 0.0, 0.0), 0.0, 1.0)]


@pytest.mark.parametrize("seed", [2, 5])
def test_disturbances_are_drawn_by_the_seed_of_the_run(seed: int) -> None:
    pulled = replace(Pulled(), cases=(Case("start", "its start", 0.05, (0.0, 0.05)),))
    log, result = fly(pulled, pulled.cases[0], "law", seed)
    assert result.fault == ""
    np.testing.assert_allclose(log["f_tool_W"][1:], np.tile([float(seed), 0.0, 0.0], (49, 1)), atol=1e-12)
