"""The law of bodie2021, part by part, and its printed equations that cannot stand."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import random_state, random_unit, rotation

from aerotact.dynamics.model import Model
from aerotact.dynamics.motion import BaseMotion
from aerotact.exceptions import MissingCapability
from aerotact.laws.bodie2021 import bodie2021_impedance_force, confidence, direct_force, impedance
from aerotact.laws.bodie2021.confidence import Span, Surface
from aerotact.laws.bodie2021.direct_force import ForceGains, Push
from aerotact.laws.bodie2021.impedance import Impedance
from aerotact.laws.bodie2021.intentional_interaction import command_wrench
from aerotact.ports import Array, BlockBuilder

GAINS = ForceGains(K_fp=0.1, K_fi=1.0, integral_max=20.0, approach_speed=1e3, approach_slope=1.0, approach_release=1.0)
SPAN = Span(0.2, 0.4)


def _array(value: Any) -> Array:
    return ca.DM(value).full().ravel()


def _impedance(rng: np.random.Generator, **more: float) -> Impedance:
    gains = {n: ca.DM(rng.uniform(1, 10, size=3)) for n in ("K_lin", "D_lin", "K_ang", "D_ang")}
    return Impedance(**(gains | {"m_wall": 0.5, "m_free": 5.0, "J_v": 4.0} | more))


def _offset(model: Model) -> Model:
    """The same robot with its centre of mass 30 mm off."""
    return Model(replace(model.robot, p_BC=np.array([0.02, -0.01, 0.02])))


def _motion(model: Model, rng: np.random.Generator, accelerations: bool = False) -> BaseMotion:
    s = model.state.unpack(random_state(model, rng))
    rest = rng.normal(size=(2, 3)) if accelerations else (None, None)
    return BaseMotion(
        *(ca.DM(s[n]) for n in ("p_WB", "q_WB", "v_WB", "w_B")), *[r if r is None else ca.DM(r) for r in rest]
    )


# nearness and confidence


def test_ramp_of_8_15_16() -> None:
    values = [float(confidence.nearness(ca.DM(d), SPAN)) for d in (-1.0, 0.2, 0.3, 0.4, 5.0)]
    np.testing.assert_allclose(values, [1, 1, 0.5, 0, 0], atol=1e-15)
    assert float(confidence.nearness(ca.DM(0.2), Span(0.2, 0.2))) == 1.0
    assert float(confidence.nearness(ca.DM(0.21), Span(0.2, 0.2))) == 0.0
    unseen = Surface(ca.DM(0.1), ca.DM([0, 0, 0]), ca.DM(0))
    assert float(confidence.surface_nearness(unseen, SPAN)) == 0.0


class _Confidence:
    """The confidence factor as a function of time."""

    def __init__(self, rate: float) -> None:
        b = BlockBuilder("confidence", "test", rate, "")
        surface = Surface(b.measurement("d", 1, "m"), ca.DM([-1, 0, 0]), b.measurement("valid", 1, "1"))
        error, wanted = b.measurement("e_t", 1, "m"), b.measurement("f_ref", 1, "N")
        near = confidence.surface_nearness(surface, SPAN)
        b.output("out", confidence.confidence(b, surface, near, error, wanted > 0, Span(0.15, 0.25), rate), "1")
        self.block, self.z = b.build(), 0.0

    def __call__(self, d: float, f_ref: float, e_t: float = 0.0, valid: float = 1.0) -> float:
        z, u = self.block.step(self.z, [d, valid, e_t, f_ref], [], self.block.parameters.default)
        self.z = float(z)
        return float(u)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_confidence_17_rises_and_falls_in_seconds_and_not_in_samples(rate: float) -> None:
    run = _Confidence(rate)
    for k in range(1, round(rate) + 1):
        assert run(0.1, 5.0) == pytest.approx(1 - np.exp(-k / rate / 0.5), abs=1e-9)
    top = run.z
    for k in range(1, round(rate) + 1):
        assert run(0.1, 0.0) == pytest.approx(top * np.exp(-k / rate / 0.5), abs=1e-9)


def test_printed_coefficient_of_17_depends_on_the_rate_and_its_end_is_a_step() -> None:
    t90 = [np.log(0.1) / np.log(1 - 0.01) / rate for rate in (100.0, 1000.0)]
    np.testing.assert_allclose(t90, [2.29, 0.229], atol=0.01)


def test_no_confidence_beyond_d_max_nor_with_a_large_tool_error() -> None:
    run = _Confidence(200.0)
    for _ in range(1000):
        assert run(0.41, 5.0) == 0.0
        assert run(0.1, 5.0, valid=0.0) == 0.0
    for _ in range(1000):
        run(0.1, 5.0)
    assert run.z > 0.99
    assert run(0.3, 5.0) == pytest.approx(0.5)
    assert run(0.41, 5.0) == 0.0
    for _ in range(1000):
        assert run(0.1, 5.0, e_t=0.26) == 0.0


def test_surface_that_is_lost_lets_the_confidence_fade() -> None:
    run = _Confidence(200.0)
    for _ in range(1000):
        run(0.1, 5.0)
    before = run.z
    after = run(0.1, 5.0, valid=0.0)
    assert before * 0.98 < after < before


# impedance


def test_virtual_mass_is_soft_along_the_tool_at_the_wall_only(tilting: Model) -> None:
    """(8)-(9) as corrected; as printed the mass at the wall would be m_free, and in the air m_wall."""
    law, axis = _impedance(np.random.default_rng(1)), ca.DM(tilting.robot.R_BE[:, 2])
    for near, along in ((1.0, 0.5), (0.0, 5.0), (0.5, 2.75)):
        ratio = ca.DM(impedance.mass_ratio(law, axis, near)).full()
        np.testing.assert_allclose(np.linalg.inv(ratio), np.diag([along, 5, 5]), atol=1e-12)
        printed = near * (5.0 - 0.5) + 0.5
        assert (printed == along) == (near == 0.5)


def test_printed_rotation_of_23_makes_another_axis_soft(tilting: Model) -> None:
    """R' Mbar_v^-1 R turns a second time: the axis z of B becomes the compliant one, and the robot sags."""
    axis = ca.DM(tilting.robot.R_BE[:, 2])
    ratio = ca.DM(impedance.mass_ratio(_impedance(np.random.default_rng(2)), axis, 1.0)).full()
    R_BT = tilting.robot.R_BE
    printed = R_BT.T @ ratio @ R_BT
    assert ratio[0, 0] == pytest.approx(2.0)
    assert ratio[2, 2] == pytest.approx(0.2)
    assert printed[2, 2] == pytest.approx(2.0)
    np.testing.assert_allclose(R_BT @ np.diag([1 / 5, 1 / 5, 1 / 0.5]) @ R_BT.T, ratio, atol=1e-12)


def _rigid_body(model: Model, base: BaseMotion, command: Array, f_ext: Array, tau_ext_O: Array) -> Array:
    """Rates of the velocities of the base's origin and of w, in B's axes, by Newton and Euler about the COM."""
    robot, c = model.robot, model.robot.p_BC
    R, v, w = rotation(_array(base.q_WB)), _array(base.v_WB), _array(base.w_B)
    torque = command[3:] + tau_ext_O - np.cross(c, f_ext)
    dw = np.linalg.solve(robot.J_C, torque - np.cross(w, robot.J_C @ w))
    a_C = (command[:3] + f_ext) / robot.mass - R.T @ [0, 0, robot.gravity]
    a_O = a_C - np.cross(dw, c) - np.cross(w, np.cross(w, c))
    return np.concatenate([a_O - np.cross(w, R.T @ v), dw])


def test_closed_loop_obeys_7_with_any_centre_of_mass(tilting: Model) -> None:
    """M_v (v_dot - v_dot_ref) + D_v e_v + K_v e_p = tau_ext at the base's origin, D_v and K_v from (11)."""
    model, rng = _offset(tilting), np.random.default_rng(3)
    robot, axis = model.robot, ca.DM(model.robot.R_BE[:, 2])
    for near in (0.0, 0.3, 1.0):
        base, reference = _motion(model, rng), _motion(model, rng, accelerations=True)
        law, wrench = _impedance(rng), rng.normal(size=6)
        f_ext, tau_ext = ca.DM(wrench[:3]), ca.DM(wrench[3:])
        ratio, errors = impedance.mass_ratio(law, axis, near), impedance.tracking_errors(base, reference)
        parts = impedance.impedance_wrench(law, errors, ratio, ca.DM.zeros(3, 3), ca.DM(robot.p_BE), f_ext, tau_ext)
        command = _array(command_wrench(model, base, reference, *parts, f_ext, tau_ext))
        rates = _rigid_body(model, base, command, wrench[:3], wrench[3:])
        dv = rates - np.concatenate([_array(v) for v in impedance.reference_acceleration(base, reference)])

        M_bar = np.linalg.inv(ca.DM(ratio).full())
        M_v_lin, M_v_ang = M_bar * robot.mass, law.J_v * robot.J_C
        damped = _array(law.D_lin * errors.e_v + law.K_lin * errors.e_p)
        turned = _array(law.D_ang * errors.e_w + law.K_ang * errors.e_R)
        np.testing.assert_allclose(M_v_lin @ dv[:3] + M_bar @ damped, wrench[:3], atol=1e-9)
        np.testing.assert_allclose(M_v_ang @ dv[3:] + law.J_v * turned, wrench[3:], atol=1e-9)


def test_reference_acceleration_is_the_derivative_in_the_axes_of_b(tilting: Model) -> None:
    """v_dot_ref of (7) by finite differences of R_BW v_ref and R_BW w_ref; (7) as printed lacks it."""
    rng, h = np.random.default_rng(4), 1e-6
    base, reference = _motion(tilting, rng), _motion(tilting, rng, accelerations=True)

    def velocities(t: float) -> Array:
        R = rotation(_array(base.q_WB)) @ Rotation.from_rotvec(t * _array(base.w_B)).as_matrix()
        R_r = rotation(_array(reference.q_WB)) @ Rotation.from_rotvec(t * _array(reference.w_B)).as_matrix()
        v = _array(reference.v_WB) + t * _array(reference.a_WB)
        return np.concatenate([R.T @ v, R.T @ R_r @ (_array(reference.w_B) + t * _array(reference.dw_B))])

    found = np.concatenate([_array(v) for v in impedance.reference_acceleration(base, reference)])
    np.testing.assert_allclose((velocities(h) - velocities(-h)) / (2 * h), found, atol=1e-6)
    assert np.linalg.norm(found) > 0.1


def test_inverse_of_the_normalised_inertia_is_m_times_the_virtual_ones() -> None:
    """(10)-(12): M M_v^-1 is the inverse of M^-1 M_v only if the two commute."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 6))
    M, M_v = np.diag([5.0, 5, 5, 0.12, 0.14, 0.18]), A @ A.T + np.eye(6)
    assert np.abs(M @ np.linalg.inv(M_v) - np.linalg.inv(np.linalg.inv(M) @ M_v)).max() > 0.1


def test_printed_coriolis_term_of_2_is_zero(tilting: Model) -> None:
    w, J = np.array([1.0, -2.0, 0.5]), tilting.robot.J_C
    np.testing.assert_array_equal(-J @ np.cross(w, w), np.zeros(3))
    assert np.linalg.norm(-np.cross(J @ w, w)) > 0.01
    np.testing.assert_allclose(-np.cross(J @ w, w), np.cross(w, J @ w))


def _at_rest(model: Model, q_WB: Array) -> tuple[BaseMotion, BaseMotion]:
    zero = ca.DM.zeros(3)
    pose = ca.DM(model.hover_state[:3]), ca.DM(q_WB), zero, zero
    return BaseMotion(*pose), BaseMotion(*pose, zero, zero)


def test_gravity_term_of_2_lifts(tilting: Model) -> None:
    """At rest without errors the command is the weight, upwards; with g of Table III as printed it points down."""
    rng, zero = np.random.default_rng(6), ca.DM.zeros(3)
    q = random_unit(rng)
    command = _array(command_wrench(tilting, *_at_rest(tilting, q), zero, zero, zero, zero))
    weight = tilting.robot.mass * tilting.robot.gravity
    np.testing.assert_allclose(rotation(q) @ command[:3], [0, 0, weight], atol=1e-9)
    printed = tilting.robot.mass * rotation(q).T @ [0, 0, -tilting.robot.gravity]
    assert printed @ command[:3] < 0


def test_com_torque_25_counts_the_contact_force(tilting: Model) -> None:
    """Pressed through the base's origin with the centre of mass off, the body does not turn; as printed it would."""
    model, zero = _offset(tilting), ca.DM.zeros(3)
    push = np.array([20.0, 0, 0])
    base, reference = _at_rest(model, np.array([1.0, 0, 0, 0]))
    command = _array(command_wrench(model, base, reference, ca.DM(push), zero, ca.DM(-push), zero))
    np.testing.assert_allclose(_rigid_body(model, base, command, -push, np.zeros(3)), np.zeros(6), atol=1e-9)
    printed = np.concatenate([command[:3], np.zeros(3)])  # torque about the origin p_com x F_cmd is none about the COM
    assert np.linalg.norm(_rigid_body(model, base, printed, -push, np.zeros(3))[3:]) > 1.0


# direct force


def test_selection_18_for_any_rotation_to_the_push() -> None:
    rng = np.random.default_rng(7)
    for _ in range(5):
        R = Rotation.from_quat(random_unit(rng)).as_matrix()
        wanted = R @ np.diag([0, 0, 0.7]) @ R.T
        np.testing.assert_allclose(ca.DM(direct_force.selection(ca.DM(R[:, 2]), 0.7)).full(), wanted, atol=1e-12)


def test_force_of_21_pushes_and_is_in_newtons() -> None:
    """Feed-forward, proportional and integral part; no 1/m, and the sign is that of the force on the wall."""
    push = Push(wanted=5.0, measured=4.0, confidence=1.0, near=1.0, limit=1e9)
    assert float(direct_force.direct_force(GAINS, push, 0.0)) == pytest.approx(5.0 + 0.1)
    assert float(direct_force.direct_force(GAINS, push, -2.0)) == pytest.approx(5.0 + 0.1 + 2.0)
    half = replace(push, confidence=0.5)
    assert float(direct_force.direct_force(GAINS, half, -2.0)) == pytest.approx(0.5 * 7.1)


def _integral(push: Push, start: float = 0.0, shortfall: float = 0.0, steps: int = 1) -> float:
    value = start
    for _ in range(steps):
        value = float(direct_force.next_integral(GAINS, push, value, shortfall, 0.005))
    return value


def test_integral_is_gated_clamped_and_stops_at_saturation() -> None:
    push = Push(wanted=5.0, measured=4.0, confidence=1.0, near=1.0, limit=1e9)
    assert _integral(push) == pytest.approx(-0.005)
    assert _integral(replace(push, confidence=0.25)) == pytest.approx(-0.00125)
    assert _integral(replace(push, confidence=0.0), start=1.5) == 1.5
    assert _integral(push, steps=10000) == pytest.approx(-20.0)
    assert _integral(push, shortfall=1.0) == 0.0, "more force cannot be given"
    assert _integral(push, shortfall=-1.0) == pytest.approx(-0.005)
    relieved = replace(push, measured=7.0)
    assert _integral(relieved, shortfall=1.0) == pytest.approx(0.01), "less is wanted"
    assert _integral(relieved, shortfall=-1.0) == 0.0
    assert _integral(replace(push, limit=1.0)) == 0.0, "the approach is limited"


def test_approach_limit_is_the_force_at_the_speed_allowed() -> None:
    """D (v - v_ref) = F - spring - measured; near the surface the limit binds with and without a push."""
    gains = replace(GAINS, approach_speed=0.01, approach_slope=0.5)
    limit = float(direct_force.approach_limit(gains, ca.DM(0.04), 60.0, 0.0, 4.0, 0.0))
    assert (limit - 4.0) / 60.0 == pytest.approx(0.01 + 0.5 * 0.04)
    push = Push(wanted=20.0, measured=0.0, confidence=1.0, near=1.0, limit=limit)
    assert float(direct_force.direct_force(gains, push, 0.0)) == pytest.approx(limit)
    idle = Push(wanted=0.0, measured=0.0, confidence=0.0, near=1.0, limit=-2.0)
    assert float(direct_force.direct_force(gains, idle, 0.0)) == pytest.approx(-2.0)
    assert float(direct_force.direct_force(gains, replace(idle, near=0.0), 0.0)) == 0.0


def test_torque_of_22_and_23_balances_a_push_that_misses_the_origin(tilting: Model) -> None:
    """Pressed askew: the torque of the direct force holds the body if the selected force's torque leaves (23).

    Without p_T x F_dir in (22) or with the whole torque estimate in (23) the body turns.
    """
    model, rng = _offset(tilting), np.random.default_rng(8)
    p_BE, u = model.robot.p_BE, np.array([0.8, 0.0, 0.6])
    law, axis = _impedance(rng), ca.DM(model.robot.R_BE[:, 2])
    base, reference = _at_rest(model, np.array([1.0, 0, 0, 0]))
    f_dir, f_ext = 10 * u, -10 * u
    tau_ext = np.cross(p_BE, f_ext)
    errors = impedance.tracking_errors(base, reference)
    ratio = impedance.mass_ratio(law, axis, 1.0)
    Lambda = direct_force.selection(ca.DM(u), 1.0)

    def turns(selected: Any, tau_dir: Array) -> float:
        f, tau = impedance.impedance_wrench(law, errors, ratio, selected, ca.DM(p_BE), ca.DM(f_ext), ca.DM(tau_ext))
        f = f - ca.mtimes(ca.DM.eye(3) - Lambda, f) + f_dir
        command = _array(command_wrench(model, base, reference, f, tau + tau_dir, ca.DM(f_ext), ca.DM(tau_ext)))
        return float(np.linalg.norm(_rigid_body(model, base, command, f_ext, tau_ext)[3:]))

    assert turns(Lambda, np.cross(p_BE, f_dir)) < 1e-9
    assert turns(Lambda, np.zeros(3)) > 1.0
    assert turns(ca.DM.zeros(3, 3), np.cross(p_BE, f_dir)) > 1.0


# the whole law


@pytest.mark.parametrize("lacking", ["tool", "force_torque", "tilt"])
def test_robot_that_lacks_something_is_told_so(tilting: Model, lacking: str) -> None:
    robot = tilting.robot
    without = {
        "tool": replace(robot, has_tool=False),
        "force_torque": replace(robot, force_torque=None),
        "tilt": replace(robot, rotors=tuple(replace(r, tilt=None) for r in robot.rotors), hover_tilt=np.zeros(0)),
    }[lacking]
    with pytest.raises(MissingCapability, match=lacking):
        bodie2021_impedance_force(Model(without), 200.0)


def test_at_hover_the_law_commands_hover(tilting: Model) -> None:
    block = bodie2021_impedance_force(tilting, 200.0)
    _, u = block.step(block.state.default, block.measurement.default, block.reference.default, block.parameters.default)
    out = block.output.unpack(u.full())
    np.testing.assert_allclose(out["thrust_cmd"], tilting.robot.hover_thrust, atol=1e-9)
    np.testing.assert_allclose(out["tilt_cmd"], tilting.robot.hover_tilt, atol=1e-9)
