"""Contact poses, bodie2021 (40)-(46): right-handed, into the surface, level; what is printed is not."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerotact.exceptions import InputError
from aerotact.experiments.contact_pose import contact_attitude, contact_pose
from aerotact.plant.plant import Plant
from aerotact.robot import load_robot

OCTOROTOR = Path(__file__).parents[1] / "fixtures" / "octorotor"
R_TB = np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])  # bodie2021: the tool's z axis is the body's x axis


def _normals() -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(50, 3))
    return [*(normals / np.linalg.norm(normals, axis=1, keepdims=True)), np.array([0, 0, 1.0]), np.array([0, 0, -1.0])]


@pytest.mark.parametrize("n_W", _normals(), ids=lambda n: np.array2string(n, precision=2))
def test_frame_is_right_handed_and_into_the_surface(n_W: np.ndarray) -> None:
    R_WE = contact_attitude(2.0 * n_W)
    np.testing.assert_allclose(R_WE @ R_WE.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R_WE) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(R_WE[:, 2], -n_W, atol=1e-12)
    assert R_WE[2, 1] == pytest.approx(0.0, abs=1e-12)  # the tool's y axis is horizontal
    assert R_WE[2, 0] <= 1e-12  # its x axis does not point up


def test_wall_in_front_is_touched_by_a_level_body() -> None:
    R_WE = contact_attitude(np.array([-1.0, 0, 0]))
    np.testing.assert_allclose(R_WE @ R_TB, np.eye(3), atol=1e-12)


def test_frame_44_as_printed_is_left_handed_and_mended_as_printed_turns_the_tool() -> None:
    R_WE = contact_attitude(np.array([-1.0, 0, 0]))
    alpha, beta = R_WE[:, 1], R_WE[:, 2]
    printed = np.column_stack([np.cross(beta, alpha), alpha, beta]) @ R_TB
    assert np.linalg.det(printed) == pytest.approx(-1.0, abs=1e-12)
    printed[:, 0] *= -1  # "the sign of the first column is flipped"
    tool_axis = (printed @ R_TB.T)[:, 2]
    np.testing.assert_allclose(tool_axis, -beta, atol=1e-12)


def test_cross_product_41_as_printed_vanishes_at_floor_and_ceiling() -> None:
    for z in (1.0, -1.0):
        n_W = np.array([0, 0, z])
        np.testing.assert_array_equal(np.cross(-n_W, [0, 0, -9.81]), 0.0)
        np.testing.assert_allclose(contact_attitude(n_W)[:, 1], [0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(contact_attitude(n_W, np.array([2.0, 0, 1.0]))[:, 1], [1, 0, 0], atol=1e-12)


def test_bad_normals_and_axes_are_refused() -> None:
    for n_W in ([0, 0, 0], [np.nan, 0, 1]):
        with pytest.raises(InputError, match="normal of a surface"):
            contact_attitude(np.array(n_W, dtype=float))
    with pytest.raises(InputError, match=r"across_W is \[0.0, 0.0, 3.0\]"):
        contact_attitude(np.array([0, 0, 1.0]), np.array([0, 0, 3.0]))


def test_base_pose_40_puts_the_plants_tool_on_the_point() -> None:
    robot = load_robot(OCTOROTOR)
    plant, rng = Plant(robot), np.random.default_rng(4)
    for _ in range(20):
        n_W = np.array([-1.0, *rng.uniform(-0.4, 0.4, 2)])
        contact = contact_pose(rng.normal(size=3), n_W)
        plant.reset(*contact.base(robot.p_BE, robot.R_BE))
        truth = plant.truth()
        np.testing.assert_allclose(truth["p_WE"], contact.p_WE, atol=1e-12)
        turn = Rotation.from_quat([truth["q_WE"], contact.q_WE], scalar_first=True)
        assert (turn[0].inv() * turn[1]).magnitude() < 1e-7
        assert abs(plant.data.xmat[plant.base_id].reshape(3, 3)[2, 1]) < 1e-9  # no roll: the body's y axis is level


def test_force_46_is_on_the_wall_and_retreat_is_off_it() -> None:
    contact = contact_pose([1, 2, 3], [-2.0, 0, 0])
    np.testing.assert_allclose(contact.force_W(5.0), [5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(contact.retreated(0.2), [0.8, 2, 3], atol=1e-12)
