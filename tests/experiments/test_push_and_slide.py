"""Push and slide: the schedule, machines by seed, and the MPC, which lands before the slide begins and stays."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.disturbed import COM_OFFSET, TILT_ZERO, disturbed_machine
from aerotact.experiments.bodie2021.push_and_slide import ARRIVE, FORCES, RAMP, SLIDE, PushAndSlide
from aerotact.experiments.experiment import Case
from aerotact.flight import fly
from aerotact.log import Log
from aerotact.metrics import Metric, push_force
from aerotact.plant.disturbance import WrenchNoise
from aerotact.plant.mismatch import CentreOfMassError, TiltError

SLIDING = PushAndSlide()
CASES = {case.name: case for case in SLIDING.cases}


@pytest.mark.parametrize("name", FORCES)
def test_what_is_judged_is_the_slide_and_all_of_it(tilting: Model, name: str) -> None:
    reference = SLIDING.reference(CASES[name], tilting)
    times = np.arange(0.0, CASES[name].duration, 0.01)
    got = reference.sample(times)
    assert CASES[name].judged == SLIDE
    moving = np.linalg.norm(got["v_WE_d"][:, 1:], axis=1) > 0
    assert moving[(times > SLIDE[0] + 0.02) & (times < SLIDE[1] - 0.02)].all()
    assert not moving[(times > ARRIVE) & (times < SLIDE[0])].any()
    if FORCES[name]:
        force = got["f_ref"][:, 0]
        assert (force[times < RAMP[0]] == 0).all()
        np.testing.assert_allclose(force[(times > RAMP[1] + 0.01) & (times < SLIDE[1])], FORCES[name])
        assert RAMP[1] + 3.0 < SLIDE[0]  # time to land, whoever does


def test_each_seed_is_another_machine_within_its_bounds() -> None:
    zeros, offsets = [], []
    for seed in range(20):
        tilt, mass, noise = disturbed_machine(seed)
        assert isinstance(tilt, TiltError)
        assert isinstance(mass, CentreOfMassError)
        assert isinstance(noise, WrenchNoise)
        zeros.append(np.rad2deg(tilt.zero))
        offsets.append(mass.offset_B)
    for drawn, bound in ((np.array(zeros), TILT_ZERO), (np.array(offsets), COM_OFFSET)):
        assert np.abs(drawn).max() <= bound
        assert np.abs(drawn.mean(axis=0)).max() < 0.5 * bound
        assert drawn.std(axis=0).min() > 0.3 * bound  # an even distribution has 0.58
    assert np.array_equal(zeros[3], np.rad2deg(disturbed_machine(3)[0].zero))  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Landing(PushAndSlide):
    """Its first 13 s."""

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        return {}


def test_the_mpc_lands_before_the_slide_begins_and_stays() -> None:
    case = replace(CASES["5N"], duration=13.0, judged=(12.0, 13.0))
    log, result = fly(Landing(), case, "mpc", 0)
    assert result.fault == ""
    force = push_force(log.columns)
    first = log.time[np.flatnonzero(force > 0)[0]]
    assert RAMP[0] < first < 11.5
    held = log.window(12.0, 13.0)
    assert (force[held] > 0).all()
    assert force[held].mean() == pytest.approx(5.0, abs=0.3)
    for limit in ("thrust", "thrust_rate", "tilt", "tilt_rate"):
        assert result.metrics[f"violations_{limit}"].value == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_mpc_beats_the_law_where_the_issue_says(seed: int) -> None:
    def flown(label: str) -> dict[str, float]:
        result = fly(SLIDING, CASES["5N"], label, seed)[1]
        assert result.fault == ""
        return {name: metric.value for name, metric in result.metrics.items() if metric.value is not None}

    law, mpc = flown("law"), flown("mpc")
    assert mpc["tool_plane_5N"] <= 0.2 * law["tool_plane_5N"]
    assert mpc["force_band_5N"] <= 0.35 * law["force_band_5N"]
    assert mpc["airborne_5N"] == 0
    assert law["force_band_5N"] == pytest.approx(1.0963, rel=0.3)  # Table VI
