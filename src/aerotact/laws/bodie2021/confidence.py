"""Nearness and confidence: how far the surface and the tool's error allow compliance and force, (8) and (13)-(17)."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.estimation.wrench_observer import first_order_gain
from aerotact.ports import BlockBuilder


@dataclass(frozen=True)
class Surface:
    """What perception says of the surface ahead.

    Attributes:
        distance: from the tool's tip along its axis, m.
        normal_W: unit normal in W towards the robot, (3,).
        valid: 1 if a surface is seen.
    """

    distance: Any
    normal_W: Any
    valid: Any


@dataclass(frozen=True)
class Span:
    """Distances, m, up to which a factor is one (`low`) and from which it is zero (`high`)."""

    low: Any
    high: Any


def nearness(distance: Any, span: Span) -> Any:
    """The ramp of (8), (15), (16): 1 up to span.low, 0 from span.high, half a cosine between; a step if low = high."""
    way = (distance - span.low) / ca.fmax(span.high - span.low, 1e-9)
    return 0.5 * (1 + ca.cos(np.pi * ca.fmin(ca.fmax(way, 0), 1)))


def surface_nearness(surface: Surface, span: Span) -> Any:
    """c of (8) and lambda_d of (15): the ramp over the distance, 0 where no surface is seen."""
    return ca.if_else(surface.valid > 0, nearness(surface.distance, span), 0)


def push_direction(b: BlockBuilder, surface: Surface, axis_W: Any) -> Any:
    """Unit vector in W along which force is exerted: against the last surface normal seen, before that the tool's axis.

    The paper has it in F_ref, (46); as a direction of its own, nothing is divided by the norm of F_ref in (14).
    """
    held = b.state("push_W", 3, "1", frame="W", doc="direction of the push, zero until a surface is seen")
    size = ca.sqrt(ca.sumsqr(surface.normal_W) + 1e-12)
    seen = ca.logic_and(surface.valid > 0, size > 0.5)
    direction = ca.if_else(seen, -surface.normal_W / size, held)
    b.update("push_W", direction)
    return ca.if_else(ca.sumsqr(direction) > 0.5, direction, axis_W)


def confidence(
    b: BlockBuilder, surface: Surface, near: Any, tool_error: Any, wanted: Any, limits: Span, rate: float
) -> Any:
    """The confidence factor lambda, (17) with the errata: filtered with a time constant in seconds, up and down.

    Beyond d_max of a surface that is seen it is zero at once; (15) has led there smoothly. Where the surface is lost it
    goes to zero with the filter.

    Args:
        b: takes the state and the parameter confidence_time.
        surface: as perceived.
        near: lambda_d of (15).
        tool_error: projected on the push, (14), m.
        wanted: 1 while force is wanted.
        limits: e_min and e_max of (16).
        rate: Hz.
    """
    before = b.state("confidence", 1, "1", doc="confidence factor lambda")
    time = b.parameter("confidence_time", 1, "s", 0.5, doc="time constant of the confidence factor, (17)", lower=1e-3)
    target = ca.if_else(wanted, near * nearness(tool_error, limits), 0)
    filtered = before + first_order_gain(1 / time, 1 / rate) * (target - before)
    after = ca.fmin(filtered, ca.if_else(surface.valid > 0, near, 1))
    b.update("confidence", after)
    return after
