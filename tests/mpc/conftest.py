"""Compiled problems with their workspace laid open."""

import pytest
from inspection import Inspected

from aerotact.mpc.ocp import Ocp


@pytest.fixture
def mpc(ocp: Ocp) -> Inspected:
    """A new controller for every test, at hover; the library comes from the cache."""
    controller = Inspected(ocp)
    controller.hover(ocp)
    return controller
