"""References of experiments: desired motions of the tool and flags, sampled at any times."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from aerotact.ports import Array
from aerotact.reference import Reference

_STEP = 1e-4  # s, of the difference that gives the angular acceleration


@dataclass(frozen=True)
class Hold:
    """The tool at rest at one pose.

    Attributes:
        p_WE: m, shape (3,).
        q_WE: wxyz, shape (4,).
    """

    p_WE: Array
    q_WE: Array

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion, one row a time."""
        n = len(times)
        zero = np.zeros((n, 3))
        return {
            "p_WE_d": np.tile(self.p_WE, (n, 1)),
            "q_WE_d": np.tile(self.q_WE, (n, 1)),
            **dict.fromkeys(("v_WE_d", "w_E_d", "a_WE_d", "dw_E_d"), zero),
        }


class Waypoints:
    """A smooth motion through poses: quintic splines of position and of the rotation vector."""

    def __init__(
        self,
        p_WE: Array,
        q_WE: Array,
        times: Sequence[float],
        offsets: Array,
        turns: Array,
        at_rest: bool = True,
    ) -> None:
        """Fit the splines.

        Args:
            p_WE, q_WE: pose from which everything is counted, m and wxyz.
            times: of the waypoints, s, increasing.
            offsets: of the position in W, m, shape (n, 3).
            turns: rotation vectors in the tool's axes at the start pose, rad, shape (n, 3), each shorter than pi.
            at_rest: velocity and acceleration vanish at both ends. If not, third and fourth derivatives do (a natural
                spline), and something else must see to rest (see `trajectory.TimeScaled`).
        """
        # The stubs know derivatives of scalar splines only.
        ends: Any = ([(order, np.zeros(3)) for order in ((1, 2) if at_rest else (3, 4))],) * 2
        self._start, self._stop = times[0], times[-1]
        self._p_WE, self._R_WE = p_WE, Rotation.from_quat(q_WE, scalar_first=True)
        self._position: BSpline = make_interp_spline(times, offsets, k=5, bc_type=ends)
        self._turn: BSpline = make_interp_spline(times, turns, k=5, bc_type=ends)

    def _rate(self, times: Array) -> Array:
        """Angular velocity in E, rad/s: right Jacobian of SO(3) times the rate of the rotation vector."""
        phi, dphi = self._turn(times), self._turn.derivative()(times)
        angle = np.linalg.norm(phi, axis=1, keepdims=True)
        small = angle < 1e-4
        safe = np.where(small, 1.0, angle)
        a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
        b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
        once = np.cross(phi, dphi)
        return np.asarray(dphi - a * once + b * np.cross(phi, once))

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion, one row a time; before the first waypoint and after the last the tool rests."""
        t = np.clip(times, self._start, self._stop)
        moving = ((times > self._start) & (times < self._stop))[:, None]
        before, after = np.clip(t - _STEP, self._start, self._stop), np.clip(t + _STEP, self._start, self._stop)
        acceleration = (self._rate(after) - self._rate(before)) / (after - before)[:, None]
        return {
            "p_WE_d": self._p_WE + self._position(t),
            "q_WE_d": (self._R_WE * Rotation.from_rotvec(self._turn(t))).as_quat(scalar_first=True),
            "v_WE_d": moving * self._position.derivative()(t),
            "w_E_d": moving * self._rate(t),
            "a_WE_d": moving * self._position.derivative(2)(t),
            "dw_E_d": moving * acceleration,
        }


@dataclass(frozen=True)
class WithFlags:
    """A motion together with flags that are 1 in given intervals.

    Attributes:
        motion: reference of the tool.
        flags: signal -> (start, stop) in s.
    """

    motion: Reference
    flags: Mapping[str, tuple[float, float]]

    def sample(self, times: Array) -> dict[str, Array]:
        """Motion and flags, one row a time."""
        on = {name: ((times >= a) & (times < b)).astype(float)[:, None] for name, (a, b) in self.flags.items()}
        return {**self.motion.sample(times), **on}


@dataclass(frozen=True)
class Together:
    """References that serve different signals at the same time.

    Attributes:
        parts: of two that serve the same signal, the later one counts.
    """

    parts: Sequence[Reference]

    def sample(self, times: Array) -> dict[str, Array]:
        """Signals of all parts, one row a time."""
        return {name: values for part in self.parts for name, values in part.sample(times).items()}
