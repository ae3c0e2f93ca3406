"""Where no limit is active, the impedance problem moves the robot as the law of bodie2021 does."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.reference import Together, Waypoints, WithFlags
from aerotact.flight import Options, fly
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.ports import Array
from aerotact.reference import Reference

PUSH = (-3.0, 2.0, 0.0)  # N, from 3 s to 7 s
M_FREE, K_LIN = 5.0, 100.0  # Table IV, experiments B and C
OBSERVER = 10.0  # rad/s, of both


class NoForce:
    """No push is wanted."""

    def sample(self, times: Array) -> dict[str, Array]:
        return {"f_ref": np.zeros((len(times), 1))}


@dataclass(frozen=True)
class Moved:
    """A motion of the tool from 1 s to 2 s, then a push on it."""

    name: str = "moved"
    doc: str = "a motion, then a push"
    robot: str = "tilt_rotor"
    world: str = "floor"
    seeds: int = 1
    cases: tuple[Case, ...] = (Case("one", "one", 8.0, (1.0, 8.0)),)
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {
            "law": ControllerSpec("bodie2021_impedance_force", 200.0, "", {"K_I_lin": OBSERVER, "K_I_ang": OBSERVER}),
            "mpc": ControllerSpec(
                "tilt_rotor_impedance", None, "", {}, {"contact_observer": {"L": OBSERVER, "K_I": OBSERVER}}
            ),
        }
    )
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        offsets, turns = np.array([[0, 0, 0], [0.1, 0.1, 0.05]]), np.array([[0, 0, 0], [0, 0, 0.1]])
        motion = Waypoints(*model.hover_tool, [1.0, 2.0], offsets, turns)
        return Together((WithFlags(motion, {"calibrate": (0.0, 0.5)}), NoForce()))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        return [ToolForce(PUSH, 3.0, 7.0, ramp=0.3)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        return {}

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        return []


@pytest.fixture(scope="module")
def flown() -> dict[str, Log]:
    moved = Moved()
    logs = {name: fly(moved, moved.cases[0], name, 0, Options(truth=True))[0] for name in moved.controllers}
    assert all(log.fault == "" and set(log.statuses) == {"OK"} for log in logs.values())
    return logs


def test_both_follow_the_same_path(flown: dict[str, Log]) -> None:
    law, mpc = (flown[name]["p_WB"][1000:3000] for name in ("law", "mpc"))
    travel = np.ptp(law, axis=0)
    assert (np.sqrt(((law - mpc) ** 2).mean(axis=0)) < 0.04 * travel).all()


@pytest.mark.parametrize("name", ["law", "mpc"])
def test_a_push_moves_the_base_by_its_share_over_the_stiffness(flown: dict[str, Log], name: str) -> None:
    """In free flight the virtual mass is m_free times the real one, and the apparent force the push over it."""
    p_WB = flown[name]["p_WB"]
    moved = p_WB[6000:6600].mean(axis=0) - p_WB[2500:2900].mean(axis=0)
    expected = np.array(PUSH) / (M_FREE * K_LIN)
    np.testing.assert_allclose(moved, expected, atol=0.8e-3)
