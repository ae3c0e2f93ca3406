"""Short problems, recorded once."""

import numpy as np
import pytest

from aerotact.bench.problems import Problem, make_problem
from aerotact.bench.qp import Linearisation, Qp
from aerotact.bench.scenario import Sample, record

STEPS, SAMPLES = 6, 24


@pytest.fixture(scope="session", params=["H", "O"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return make_problem(request.param, STEPS)


@pytest.fixture(scope="session")
def samples(problem: Problem) -> list[Sample]:
    return record(problem, SAMPLES, seed=3)


@pytest.fixture(scope="session")
def qps(problem: Problem, samples: list[Sample]) -> list[Qp]:
    linearise = Linearisation(problem.transcription, problem.parameters)
    return [linearise(s.x, s.u, s.stages, s.measured) for s in samples]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)
