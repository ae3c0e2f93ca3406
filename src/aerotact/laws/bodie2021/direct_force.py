"""Direct force control: a feed-forward with a proportional-integral correction along the push, (18)-(22)."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.ports import BlockBuilder

TOLERANCE = 0.01  # N, of what the rotors fall short


@dataclass(frozen=True)
class ForceGains:
    """K_fp and K_fi (1/s) of (21), the largest force of the integral, N, and the approach: its speed allowed, a + b d,
    and how far a measured force lifts that limit."""

    K_fp: Any
    K_fi: Any
    integral_max: Any
    approach_speed: Any
    approach_slope: Any
    approach_release: Any


@dataclass(frozen=True)
class Push:
    """A push on the environment along one direction.

    Attributes:
        wanted: force along it, N.
        measured: the same of the sensor, N.
        confidence: lambda of (17).
        near: c of (8).
        limit: force beyond which the tool would approach too fast, N (see `approach_limit`).
    """

    wanted: Any
    measured: Any
    confidence: Any
    near: Any
    limit: Any


def add_force_gains(b: BlockBuilder) -> ForceGains:
    """Parameters, with the values of Table IV; the paper limits neither the integral nor the approach."""

    def gain(name: str, unit: str, default: float, doc: str) -> Any:
        return b.parameter(name, 1, unit, default, doc=doc, lower=0.0)

    return ForceGains(
        K_fp=gain("K_fp", "1", 0.1, "proportional gain of the force error, (21)"),
        K_fi=gain("K_fi", "1/s", 1.0, "integral gain of the force error, (21)"),
        integral_max=gain("integral_max", "N", 20.0, "largest force of the integral"),
        approach_speed=gain("approach_speed", "m/s", 1e3, "speed towards the surface allowed at it"),
        approach_slope=gain("approach_slope", "1/s", 1.0, "more speed allowed for each metre away from it"),
        approach_release=gain("approach_release", "1", 1.0, "share of the measured force by which the limit rises"),
    )


def selection(direction: Any, confidence: Any) -> Any:
    """Lambda, (18): R diag(0, 0, lambda) R' with any R that turns z to the direction is lambda u u'; (3, 3)."""
    return confidence * ca.mtimes(direction, direction.T)


def approach_limit(
    gains: ForceGains, distance: Any, damping: Any, reference_speed: Any, spring: Any, measured: Any
) -> Any:
    """Force of the direct control, N, at which the tool approaches with the speed allowed; not of the paper.

    Against the damping D of (11), the spring force of the impedance and what the surface already takes, a force F moves
    the tool along the push at v with D (v - v_ref) = F - spring - measured. The limit rises with the measured force: it
    binds the motion towards the surface and no steady force. With a release of 1 a step of the force, too, is taken no
    faster than the tool would approach; more than 1 lets it go once there is contact.

    Args:
        gains: approach_speed, approach_slope and approach_release.
        distance: of the surface, m.
        damping: effective damping along the push, N s/m.
        reference_speed: of the reference along the push, m/s.
        spring: effective stiffness times position error along the push, N.
        measured: force on the environment along the push, N.
    """
    speed = gains.approach_speed + gains.approach_slope * ca.fmax(distance, 0)
    return damping * (speed - reference_speed) + spring + gains.approach_release * measured


def unlimited_force(gains: ForceGains, push: Push, integral: Any) -> Any:
    """Force along the push, N, (21) with the errata: lambda (F_ref - K_fp e_f - K_fi int e_f), e_f of (20)."""
    e_f = push.measured - push.wanted
    return push.confidence * (push.wanted - gains.K_fp * e_f - gains.K_fi * integral)


def direct_force(gains: ForceGains, push: Push, integral: Any) -> Any:
    """(21) less what exceeds the limit of the approach; near a surface that holds without a push, too."""
    force = unlimited_force(gains, push, integral)
    return force - push.near * ca.fmax(force - push.limit, 0)


def next_integral(gains: ForceGains, push: Push, integral: Any, shortfall: Any, period: float) -> Any:
    """Integral of (21), N s, one period later.

    It runs with the confidence, holds within +-integral_max / K_fi, and stands still where it would drive the force
    further beyond what the rotors can give or the approach allows.

    Args:
        gains: of (21).
        push: as given to `direct_force`.
        integral: now, N s.
        shortfall: force along the push that was commanded and cannot be given, N.
        period: s.
    """
    e_f = push.measured - push.wanted
    too_much = ca.logic_or(unlimited_force(gains, push, integral) > push.limit, shortfall > TOLERANCE)
    stuck = ca.logic_or(ca.logic_and(too_much, e_f < 0), ca.logic_and(shortfall < -TOLERANCE, e_f > 0))
    moved = integral + ca.if_else(stuck, 0, period * push.confidence * e_f)
    most = gains.integral_max / ca.fmax(gains.K_fi, 1e-6)
    return ca.fmin(ca.fmax(moved, -most), most)
