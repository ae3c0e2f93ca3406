"""The virtual mass-spring-damper of ryll2019 (27)-(28), against scipy's integration of the same equations."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from stepping import random_unit

from aerotact.dynamics.admittance import Admittance, ToolMotion, acceleration, advance, attitude_error, dead_zone

LAW = Admittance(
    M_p=ca.DM([1.5, 0.75, 3.0]),
    D_p=ca.DM([10.0, 5.0, 20.0]),
    K_p=ca.DM([6.0, 4.0, 8.0]),
    M_r=ca.DM([0.05, 0.06, 0.08]),
    D_r=ca.DM([0.6, 0.5, 0.7]),
    K_r=ca.DM([2.0, 3.0, 1.0]),
)
WRENCH = ca.DM([1.2, -0.5, 0.3, 0.4, -0.6, 0.2])
W_D, DW_D = np.array([0.2, -0.3, 0.5]), np.zeros(3)


def _desired(t: float) -> ToolMotion:
    """A desired motion: oscillating in place, turning at a constant rate in W."""
    turn = Rotation.from_rotvec(t * W_D)
    return ToolMotion(
        p_WE=ca.DM([np.sin(t), 0.2 * t, 1.0]),
        q_WE=ca.DM(turn.as_quat(scalar_first=True)),
        v_WE=ca.DM([np.cos(t), 0.2, 0.0]),
        w_WE=ca.DM(W_D),
        a_WE=ca.DM([-np.sin(t), 0.0, 0.0]),
        dw_WE=ca.DM(DW_D),
    )


def _still(q: np.ndarray | None = None) -> ToolMotion:
    zero = ca.DM.zeros(3)
    return ToolMotion(zero, ca.DM([1, 0, 0, 0] if q is None else q), zero, zero, zero, zero)


def _march(h: float, duration: float) -> ToolMotion:
    now = _desired(0.0)
    for k in range(round(duration / h)):
        now = advance(LAW, _desired(k * h), _desired((k + 1) * h), now, WRENCH, h)
    return now


def _exact(duration: float) -> np.ndarray:
    """p, q, v, w of the reference by a fine integration of (27)."""

    def slope(t: float, s: np.ndarray) -> np.ndarray:
        p, q, v, w = s[0:3], s[3:7], s[7:10], s[10:13]
        here = ToolMotion(ca.DM(p), ca.DM(q), ca.DM(v), ca.DM(w), None, None)
        a, dw = (x.full().ravel() for x in acceleration(LAW, _desired(t), here, WRENCH))
        dq = 0.5 * np.array([-w @ q[1:], *(w * q[0] + np.cross(w, q[1:]))])
        return np.concatenate([v, dq, a, dw])

    start = _desired(0.0)
    first = np.concatenate([x.full().ravel() for x in (start.p_WE, start.q_WE, start.v_WE, start.w_WE)])
    return solve_ivp(slope, (0, duration), first, rtol=1e-10, atol=1e-12).y[:, -1]


def _errors(end: ToolMotion, exact: np.ndarray) -> list[float]:
    values = [x.full().ravel() for x in (end.p_WE, end.q_WE, end.v_WE, end.w_WE)]
    return [float(np.abs(a - b).max()) for a, b in zip(values, np.split(exact, [3, 7, 10]), strict=True)]


def test_advance_follows_the_equation() -> None:
    """Exact in translation; in rotation of first order, as (28) is taken as linear over a step."""
    exact = _exact(1.0)
    coarse, fine = _errors(_march(0.02, 1.0), exact), _errors(_march(0.01, 1.0), exact)
    assert max(coarse[0], coarse[2]) < 1e-8
    for rough, smooth in ((coarse[1], fine[1]), (coarse[3], fine[3])):
        assert rough < 2e-3
        assert rough / smooth == pytest.approx(2, rel=0.2)


@pytest.mark.parametrize(
    ("M", "D", "K"),
    [
        (1.5, 10.0, 6.0),  # over-damped
        (1.0, 4.0, 4.0),  # double root
        (1.0, 4.0 + 1e-9, 4.0),  # beside it
        (1.5, 1.0, 60.0),  # under-damped
        (2.0, 0.0, 8.0),  # without damping
        (2.0, 3.0, 0.0),  # without spring
        (2.0, 0.0, 0.0),  # a free mass
    ],
)
def test_translation_is_exact_for_every_kind_of_damping(M: float, D: float, K: float) -> None:
    law = Admittance(*(ca.DM([v] * 3) for v in (M, D, K)), LAW.M_r, LAW.D_r, LAW.K_r)
    start, h, w = _still(), 0.05, 1.2
    now = ToolMotion(ca.DM([0.1, 0, 0]), start.q_WE, ca.DM([-0.2, 0, 0]), start.w_WE, None, None)
    for _ in range(20):
        now = advance(law, _still(), _still(), now, ca.DM([w, 0, 0, 0, 0, 0]), h)
    exact = solve_ivp(
        lambda t, s: [s[1], (w - D * s[1] - K * s[0]) / M], (0, 20 * h), [0.1, -0.2], rtol=1e-11, atol=1e-13
    ).y[:, -1]
    np.testing.assert_allclose([float(now.p_WE[0]), float(now.v_WE[0])], exact, atol=1e-6)


def test_steady_state_is_wrench_over_stiffness() -> None:
    wrench = ca.DM([1.2, -0.6, 0.4, 0.5, 0.0, 0.0])
    now = _still()
    for _ in range(600):
        now = advance(LAW, _still(), _still(), now, wrench, 0.1)
    np.testing.assert_allclose(now.p_WE.full().ravel(), [1.2 / 6, -0.6 / 4, 0.4 / 8], atol=1e-6)
    angle = Rotation.from_quat(now.q_WE.full().ravel(), scalar_first=True).as_rotvec()
    np.testing.assert_allclose(angle, [np.arcsin(0.5 / 2.0), 0, 0], atol=1e-6)
    assert np.abs(now.v_WE.full()).max() < 1e-6


def test_printed_sign_of_27_moves_against_the_force() -> None:
    """With e = desired - reference, as printed, the reference settles at -w/K: against the push."""
    p, v, h, (M, D, K, w) = 0.0, 0.0, 1e-3, (1.5, 10.0, 6.0, 1.2)
    for _ in range(20_000):
        v += h * -(w - D * -v - K * -p) / M  # M (0 - a) + D (0 - v) + K (0 - p) = w solved for a
        p += h * v
    assert p == pytest.approx(-w / K, abs=1e-4)


def test_advance_is_stable_however_stiff() -> None:
    stiff = Admittance(*(ca.DM([v] * 3) for v in (1e-3, 4.0, 1e4)), *(ca.DM([v] * 3) for v in (1e-4, 4.0, 100.0)))
    now = _still()
    for _ in range(500):
        now = advance(stiff, _still(), _still(), now, WRENCH, 0.02)
        assert np.abs(now.p_WE.full()).max() < 1.0
    assert np.isfinite(now.w_WE.full()).all()


def test_attitude_error_is_in_the_world_frame() -> None:
    """Turned by a small phi in W, whatever the attitude before."""
    q = random_unit(np.random.default_rng(12))
    phi = np.array([1e-4, -2e-4, 3e-4])
    turned = (Rotation.from_rotvec(phi) * Rotation.from_quat(q, scalar_first=True)).as_quat(scalar_first=True)
    np.testing.assert_allclose(attitude_error(ca.DM(q), ca.DM(turned)).full().ravel(), phi, atol=1e-10)


@pytest.mark.parametrize(("norm", "left"), [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.5, 0.3), (1.4, 1.2)])
def test_dead_zone_shortens_by_the_threshold(norm: float, left: float) -> None:
    direction = np.array([0.6, 0.0, 0.8])
    short = dead_zone(ca.DM(norm * direction), 0.2).full().ravel()
    np.testing.assert_allclose(short, left * direction, atol=1e-12)
