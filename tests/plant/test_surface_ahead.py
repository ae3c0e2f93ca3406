"""The true surface ahead of the tool, against the geometry of the worlds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.plant.plant import Plant
from aerotact.plant.surface import SurfaceAhead
from aerotact.robot import Robot


def test_distance_is_along_the_tools_axis_and_normal_towards_the_robot(octorotor: Robot) -> None:
    plant = Plant(octorotor, "wall")
    ahead, rng = SurfaceAhead(plant, 4.0), np.random.default_rng(1)
    for _ in range(50):
        turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
        plant.reset(rng.uniform([-0.5, -0.2, 1.0], [0.1, 0.2, 1.4]), turn.as_quat(scalar_first=True))
        tool, found = plant.data.site("lance_end"), ahead.sample()
        expected = (1.0 - tool.xpos[0]) / tool.xmat.reshape(3, 3)[0, 2]
        assert found["surface_distance"] == pytest.approx(expected, abs=1e-12)
        np.testing.assert_allclose(found["n_W"], [-1, 0, 0], atol=1e-12)
        assert found["surface_valid"] == 1.0


def test_tip_that_has_pressed_in_is_at_a_negative_distance(octorotor: Robot) -> None:
    plant = Plant(octorotor, "wall")
    plant.reset([0.30, 0, 1.2])
    found = SurfaceAhead(plant, 4.0).sample()
    assert found["surface_distance"] == pytest.approx(-0.01, abs=1e-12)
    np.testing.assert_allclose(found["n_W"], [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(("world", "x"), [("wall", -5.0), ("wall", 0.9), (None, 0.0)])
def test_nothing_ahead_is_far_and_against_the_axis(world: str | None, x: float, octorotor: Robot) -> None:
    """Too far away, behind the tip by more than any surface gives way, or empty space."""
    plant = Plant(octorotor, world)
    plant.reset([x, 0, 1.2], [0.9, 0.1, 0.1, np.sqrt(1 - 0.83)])
    found = SurfaceAhead(plant, 4.0).sample()
    assert (found["surface_distance"], found["surface_valid"]) == (4.0, 0.0)
    np.testing.assert_allclose(found["n_W"], -plant.data.site("lance_end").xmat.reshape(3, 3)[:, 2], atol=1e-15)
