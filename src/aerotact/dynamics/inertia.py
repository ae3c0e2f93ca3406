"""Inertia: mass, first moment and inertia tensor of a body about a point, as CasADi expressions."""

from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class Inertia:
    """Of a body about a point, in axes of B.

    Attributes:
        mass: kg.
        moment: mass times the centre of mass, kg m, (3,).
        inertia: about the point, kg m2, (3, 3).
    """

    mass: float
    moment: Any
    inertia: Any

    def seen_from(self, p: Any) -> "Inertia":
        """About the point p (3,), m."""
        c = self.moment - self.mass * p
        shift = ca.dot(p, self.moment + c) * ca.DM.eye(3) - ca.mtimes(p, c.T) - ca.mtimes(self.moment, p.T)
        return Inertia(self.mass, c, self.inertia - shift)

    def wrench(self, a: Any, w: Any, dw: Any) -> tuple[Any, Any]:
        """Force, N, and torque about the point, N m, that give it acceleration a of the point, rate w, and dw."""
        force = self.mass * a + ca.cross(dw, self.moment) + ca.cross(w, ca.cross(w, self.moment))
        return force, ca.cross(self.moment, a) + ca.mtimes(self.inertia, dw) + ca.cross(w, ca.mtimes(self.inertia, w))
