"""Robots for the tests of the plant."""

from pathlib import Path

import pytest

from aerotact.robot import Robot, load_robot

OCTOROTOR = Path(__file__).parents[1] / "fixtures" / "octorotor"


@pytest.fixture(scope="session")
def tilt_hex() -> Robot:
    return load_robot("tilt_hex")


@pytest.fixture(scope="session")
def octorotor() -> Robot:
    return load_robot(OCTOROTOR)


@pytest.fixture(scope="session")
def tilting() -> Robot:
    return load_robot("tilt_rotor")


@pytest.fixture(scope="session", params=["tilt_hex", "octorotor", "tilting"])
def robot(request: pytest.FixtureRequest, tilt_hex: Robot, octorotor: Robot, tilting: Robot) -> Robot:
    return {"tilt_hex": tilt_hex, "octorotor": octorotor, "tilting": tilting}[request.param]
