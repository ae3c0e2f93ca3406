"""TipFriction: LuGre friction of the tool's tip on the surfaces that it touches.

MuJoCo's own friction makes a stiff, light tip hop, so the tip's contacts are frictionless (condim 1) and this force is
added. The model is that of Canudas de Wit et al., "A new model for control of systems with friction", IEEE Transactions
on Automatic Control 40(3), 1995, with a constant friction level (no Stribeck effect) and all coefficients per newton of
normal force.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from aerotact.ports import Array

STIFFNESS = 5e3
"""sigma0: bristle stiffness per newton of normal force, 1/m."""
DAMPING = 2.0
"""sigma1: bristle damping per newton of normal force, s/m."""

Key = tuple[int, int, int]
"""Geom id of the tip, geom id of the touched surface, number of the contact between the two."""


@dataclass(frozen=True, slots=True)
class TipContact:
    """One point where the tip touches.

    Attributes:
        key: which contact it is.
        p_WC: contact point in W, m, shape (3,).
        n_W: unit normal out of the surface in W, shape (3,).
        normal_force: pressing force as solved last, N, not negative.
        friction: Coulomb coefficient of the surface.
        v_WS: velocity of the surface at the contact point in W, m/s, shape (3,).
    """

    key: Key
    p_WC: Array
    n_W: Array
    normal_force: float
    friction: float
    v_WS: Array = field(default_factory=lambda: np.zeros(3))


def lugre_step(
    bristle: Array,
    velocity: Array,
    normal_force: float,
    friction: float,
    timestep: float,
    stiffness: float = STIFFNESS,
    damping: float = DAMPING,
) -> tuple[Array, Array]:
    """One step of z_dot = v - sigma0 |v| z / mu, solved exactly for a velocity that is constant over the step.

    The force is -N (sigma0 z + sigma1 z_dot) with z at the step's end and z_dot as the step's mean, cut to the Coulomb
    disc of radius mu N. At a steady velocity it is -mu N v / |v|.

    Args:
        bristle: deflection z, m, shape (3,).
        velocity: of the tip relative to the surface, tangential, m/s, shape (3,).
        normal_force: N, in newtons.
        friction: Coulomb coefficient mu.
        timestep: s.
        stiffness: sigma0, 1/m.
        damping: sigma1, s/m.

    Returns:
        Deflection at the step's end, m, and the friction force on the tip, N, both of shape (3,).
    """
    speed = math.sqrt(velocity @ velocity)
    if friction <= 0.0:
        return np.zeros(3), np.zeros(3)
    decay = stiffness * speed / friction
    travel = -math.expm1(-decay * timestep) / decay if decay * timestep > 1e-12 else timestep
    bristle_next = bristle * math.exp(-decay * timestep) + velocity * travel
    force = -normal_force * (stiffness * bristle_next + damping / timestep * (bristle_next - bristle))
    size, most = math.sqrt(force @ force), friction * normal_force
    if size > most:
        force *= most / size
    return bristle_next, force


@dataclass
class TipFriction:
    """Bristle deflections of the tip, one for each contact that lasts.

    Attributes:
        stiffness: sigma0 per newton of normal force, 1/m.
        damping: sigma1 per newton of normal force, s/m.
        bristles: key of the contact -> deflection in W, m, shape (3,).
    """

    stiffness: float = STIFFNESS
    damping: float = DAMPING
    bristles: dict[Key, Array] = field(default_factory=dict)

    def reset(self) -> None:
        """Forget all deflections."""
        self.bristles.clear()

    def step(self, contacts: list[TipContact], v_WE: Array, w_W: Array, p_WE: Array, timestep: float) -> list[Array]:
        """Advance by one step.

        Args:
            contacts: where the tip touches.
            v_WE: velocity of the tool's origin in W, m/s, shape (3,).
            w_W: angular velocity of the tool in W, rad/s, shape (3,).
            p_WE: position of the tool's origin in W, m, shape (3,).
            timestep: s.

        Returns:
            Friction force on the tip in W for each contact, N, each of shape (3,).
        """
        forces: list[Array] = []
        bristles: dict[Key, Array] = {}
        for contact in contacts:
            n = contact.n_W
            r = contact.p_WC - p_WE
            v = v_WE + np.array(
                [w_W[1] * r[2] - w_W[2] * r[1], w_W[2] * r[0] - w_W[0] * r[2], w_W[0] * r[1] - w_W[1] * r[0]]
            )
            v = v - contact.v_WS
            z = self.bristles.get(contact.key)
            z = np.zeros(3) if z is None else z - n * (n @ z)
            z, force = lugre_step(
                z, v - n * (n @ v), contact.normal_force, contact.friction, timestep, self.stiffness, self.damping
            )
            bristles[contact.key] = z
            forces.append(force)
        self.bristles = bristles
        return forces
