"""Planner error beside the wall: where the tool is sent, and that every false contact and attempt is counted."""

import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.planner_error import AWAY, BESIDE, D_MAX, MISGUIDED, PlannerError
from aerotact.experiments.bodie2021.wall import WALL
from aerotact.flight import fly
from aerotact.log import Log
from aerotact.ports import Array
from aerotact.robot import load_robot

ERROR = PlannerError()
CASE = next(case for case in ERROR.cases if case.name == BESIDE)
TIME = np.arange(0.0, AWAY, 0.01)


@pytest.fixture(scope="module")
def wanted() -> dict[str, Array]:
    return dict(ERROR.reference(CASE, Model(load_robot(ERROR.robot))).sample(TIME))


@pytest.fixture
def quiet(wanted: dict[str, Array]) -> dict[str, Array]:
    """Columns of a flight that goes as wanted, without contact or confidence."""
    n = len(TIME)
    return {
        "time": TIME[:, None],
        "surface_distance": WALL - wanted["p_WE_d"][:, :1],
        "f_contact_W": np.zeros((n, 3)),
        "n_W": np.tile([-1.0, 0.0, 0.0], (n, 1)),
        "confidence_factor": np.zeros((n, 1)),
        "contact_est": np.zeros((n, 1)),
    }


def test_the_tool_stays_between_a_quarter_and_half_a_metre_from_the_wall(wanted: dict[str, Array]) -> None:
    gap = WALL - wanted["p_WE_d"][:, 0]
    assert gap.min() == pytest.approx(0.25)
    assert gap.max() == pytest.approx(0.5)
    misguided = (MISGUIDED[0] <= TIME) & (MISGUIDED[1] > TIME)
    assert gap[misguided].min() > D_MAX
    assert wanted["f_ref"][misguided].max() == 5.0
    assert wanted["f_ref"][~misguided].max() == 0.0


def test_false_contacts_and_attempts_are_counted(quiet: dict[str, Array]) -> None:
    log = Log(0.01, quiet, {}, {})
    found = ERROR.metrics(CASE, log)
    assert [found[name].value for name in ("false_contacts", "false_attempts", "true_contacts")] == [0, 0, 0]
    quiet["contact_est"][600:603] = 1.0
    quiet["confidence_factor"][1000:1005] = 0.01
    quiet["f_contact_W"][700] = [-1.0, 0.0, 0.0]
    found = ERROR.metrics(CASE, log)
    assert [found[name].value for name in ("false_contacts", "false_attempts", "true_contacts")] == [3, 5, 1]


def test_each_seed_flies_a_machine_of_its_own() -> None:
    model = Model(load_robot(ERROR.robot))
    machines = [str(ERROR.disturbances(CASE, model, seed)) for seed in (0, 0, 1)]
    assert machines[0] == machines[1] != machines[2]
    assert ERROR.disturbances(ERROR.cases[0], model, 1) == []


@pytest.mark.parametrize("controller", ["law", pytest.param("mpc", marks=pytest.mark.slow)])
def test_nothing_passes_for_a_contact_in_free_flight_beside_a_wall(controller: str) -> None:
    for seed in (0, 1):
        _, result = fly(ERROR, CASE, controller, seed)
        assert result.fault == ""
        for name in ("false_contacts", "false_attempts", "true_contacts"):
            assert result.metrics[name].value == 0
