"""Quaternions, rotation matrices and the chart, against scipy and against finite differences."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import random_unit

from aerotact.dynamics import so3


def _full(value: ca.DM) -> np.ndarray:
    return value.full().squeeze()


def _scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def test_rotation_product_and_conjugate_equal_scipy() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        a, b = random_unit(rng), random_unit(rng)
        np.testing.assert_allclose(_full(so3.rotation(ca.DM(a))), _scipy(a).as_matrix(), atol=1e-14)
        both = _full(so3.rotation(so3.product(ca.DM(a), ca.DM(b))))
        np.testing.assert_allclose(both, (_scipy(a) * _scipy(b)).as_matrix(), atol=1e-14)
        back = _full(so3.product(ca.DM(a), so3.conjugate(ca.DM(a))))
        np.testing.assert_allclose(back, [1, 0, 0, 0], atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 0.5, 3.0, np.pi, 5.0])
def test_exponential_equals_scipy(angle: float) -> None:
    axis = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    q = _full(so3.exponential(ca.DM(angle * axis)))
    assert abs(np.linalg.norm(q) - 1) < 1e-14
    np.testing.assert_allclose(_scipy(q).as_matrix(), Rotation.from_rotvec(angle * axis).as_matrix(), atol=1e-14)


def test_skew_and_vee() -> None:
    a, b = ca.DM([1, -2, 3]), ca.DM([0.3, 0.2, -0.1])
    np.testing.assert_allclose(_full(ca.mtimes(so3.skew(a), b)), np.cross(_full(a), _full(b)), atol=1e-15)
    np.testing.assert_array_equal(_full(so3.vee(so3.skew(a))), _full(a))


def test_chart_goes_there_and_back() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        a, b = ca.DM(random_unit(rng)), ca.DM(random_unit(rng))
        sigma = so3.local(a, b)
        assert np.linalg.norm(_full(sigma)) <= 4 + 1e-12
        reached = _full(so3.retract(a, sigma))
        np.testing.assert_allclose(abs(reached @ _full(b)), 1, atol=1e-14)


@pytest.mark.parametrize("below_pi", [1e-1, 1e-4, 1e-8, 0.0])
def test_chart_holds_near_pi(below_pi: float) -> None:
    axis = np.array([0.6, 0.0, -0.8])
    q = ca.DM(np.concatenate([[np.cos((np.pi - below_pi) / 2)], np.sin((np.pi - below_pi) / 2) * axis]))
    sigma = so3.to_chart(q)
    np.testing.assert_allclose(_full(sigma), 4 * np.tan((np.pi - below_pi) / 4) * axis, atol=1e-12)
    np.testing.assert_allclose(_full(so3.from_chart(sigma)), _full(q), atol=1e-14)


def test_chart_equals_the_rotation_vector_to_third_order() -> None:
    phi = np.array([0.3, -0.2, 0.1])
    errors = [np.linalg.norm(_full(so3.to_chart(so3.exponential(ca.DM(s * phi)))) - s * phi) for s in (1.0, 0.5)]
    assert errors[0] / errors[1] == pytest.approx(8, rel=0.05)


def test_chart_jacobian_by_finite_differences_at_zero_and_near_pi() -> None:
    q = ca.SX.sym("q", 4)
    jacobian = ca.Function("J", [q], [ca.jacobian(so3.to_chart(q), q)])
    chart = ca.Function("c", [q], [so3.to_chart(q)])
    for angle in (0.0, 1e-8, 1.0, np.pi - 1e-3):
        at = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * np.array([0.6, 0.8, 0.0])])
        h = 1e-6
        differences = [_full(chart(at + h * e) - chart(at - h * e)) / (2 * h) for e in np.eye(4)]
        np.testing.assert_allclose(_full(jacobian(at)), np.array(differences).T, atol=1e-5)


def test_quaternion_rate_by_finite_differences() -> None:
    rng = np.random.default_rng(3)
    q, w, h = ca.DM(random_unit(rng)), ca.DM(rng.normal(size=3)), 1e-6
    ahead, behind = (so3.product(q, so3.exponential(s * h * w)) for s in (1, -1))
    np.testing.assert_allclose(_full(so3.quaternion_rate(q, w)), _full(ahead - behind) / (2 * h), atol=1e-8)
