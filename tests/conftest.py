"""Robots, models and what is generated from them, each made once a session; all workers share what is compiled."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from native import Native

from aerotact.codegen.mpc_project import mpc_project
from aerotact.codegen.project import CProject, block_project
from aerotact.dynamics.model import Model
from aerotact.estimation import estimators
from aerotact.exceptions import MissingCapability
from aerotact.laws import laws
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Block
from aerotact.robot import load_robot

ROOT = Path(__file__).parents[1]
ROBOTS = {
    **{name: ROOT / "models" / name for name in ("tilt_hex", "tilt_rotor")},
    "octorotor": ROOT / "tests" / "fixtures" / "octorotor",
}
FIXED = ("octorotor", "tilt_hex")  # robots whose rotors do not tilt
PROBLEM = ROOT / "ocp" / "tilt_hex_admittance.toml"
RATE = 500.0
BLOCKS = sorted({**laws(), **estimators()})


@pytest.fixture(scope="session", autouse=True)
def compile_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of this session's own, one for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AEROTACT_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def models() -> dict[str, Model]:
    return {name: Model(load_robot(folder)) for name, folder in ROBOTS.items()}


@pytest.fixture(scope="session", params=sorted(ROBOTS))
def model(request: pytest.FixtureRequest, models: dict[str, Model]) -> Model:
    return models[request.param]


@pytest.fixture(scope="session")
def hexarotor(models: dict[str, Model]) -> Model:
    """The model of models/tilt_hex."""
    return models["tilt_hex"]


@pytest.fixture(scope="session")
def tilting(models: dict[str, Model]) -> Model:
    """The model of models/tilt_rotor."""
    return models["tilt_rotor"]


@pytest.fixture(scope="session", params=BLOCKS)
def block(request: pytest.FixtureRequest, model: Model) -> Block:
    """Every law and every estimator, for every robot that has what it needs; tests/contract looks at the others."""
    try:
        return {**laws(), **estimators()}[request.param](model, RATE)
    except MissingCapability as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def block_c(block: Block, model: Model) -> CProject:
    return block_project(block, model)


@pytest.fixture(scope="session")
def ocps(models: dict[str, Model]) -> dict[str, Ocp]:
    return {name: load_ocp(PROBLEM, models[name]) for name in FIXED}


@pytest.fixture(scope="session", params=FIXED)
def ocp(request: pytest.FixtureRequest, ocps: dict[str, Ocp]) -> Ocp:
    return ocps[request.param]


@pytest.fixture(scope="session")
def mpc_c(ocp: Ocp) -> CProject:
    return mpc_project(ocp)


@pytest.fixture(scope="session")
def hexarotor_ocp(ocps: dict[str, Ocp]) -> Ocp:
    return ocps["tilt_hex"]


@pytest.fixture(scope="session")
def native() -> Callable[[CProject], Native]:
    """From a project to its compiled functions, each library loaded once."""
    loaded: dict[str, Native] = {}

    def load(project: CProject) -> Native:
        return loaded.setdefault(project.digest, Native(project))

    return load


@pytest.fixture
def problem_text() -> str:
    """The ocp file of models/tilt_hex, to be spoilt."""
    return PROBLEM.read_text()


@pytest.fixture(scope="session")
def short_problem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same problem over four intervals, for what is slow."""
    text = PROBLEM.read_text()
    start, end = text.index("times = ["), text.index("]\n", text.index("times = ["))
    path = tmp_path_factory.mktemp("ocp") / "short_admittance.toml"
    path.write_text(text[:start] + "times = [0.0, 0.01, 0.03, 0.09, 0.24" + text[end:])
    return path
