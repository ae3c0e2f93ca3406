"""ContactSeries: contacts one after the other, each from free flight and back, and how well each was held.

bodie2021 IV-B: rest to rest between poses before the surface and on it, sampled at 100 Hz; the force on a sinusoidal
ramp. Every contact of a flight takes the same time, so that its rows in a log follow from its number alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.experiments.bodie2021.wall import CALIBRATE, DEPART
from aerotact.experiments.contact_pose import ContactPose
from aerotact.experiments.force_profile import RAMP_SHARE, ForceProfile, press
from aerotact.experiments.reference import Together, WithFlags
from aerotact.experiments.trajectory import Move, Sampled, rest_to_rest
from aerotact.metrics import in_band, push_force
from aerotact.ports import Array
from aerotact.reference import Reference

APPROACH, WAIT, RETREAT = 2.0, 0.5, 1.5  # s
UPRIGHT = np.radians(10.0)
NEAR = 0.05  # m


@dataclass(frozen=True)
class ContactSeries:
    """When the contacts of a flight are.

    Attributes:
        count: of contacts.
        force: that each is held with, N.
        duration: of the force at each, its ramps included, s.
        transfer: time from before one contact to before the next, s.
        stand_off: distance of the tool from the surface in between, m.
    """

    count: int
    force: float
    duration: float
    transfer: float
    stand_off: float

    @property
    def period(self) -> float:
        """From one contact to the next, s."""
        return self.transfer + APPROACH + WAIT + self.duration + RETREAT

    @property
    def end(self) -> float:
        """Of the flight, s."""
        return DEPART + self.count * self.period

    def pressed(self, number: int) -> tuple[float, float]:
        """When a force is wanted at a contact, s."""
        start = DEPART + number * self.period + self.transfer + APPROACH + WAIT
        return start, start + self.duration

    def held(self, number: int) -> tuple[float, float]:
        """When the whole force is wanted at a contact, s."""
        start, stop = self.pressed(number)
        return start + RAMP_SHARE * self.duration, stop - RAMP_SHARE * self.duration

    def reference(self, hover_tool: tuple[Array, Array], contacts: Sequence[ContactPose]) -> Reference:
        """From hover to each contact and back to before the last; the force at each.

        Args:
            hover_tool: p_WE, m, and q_WE at the start.
            contacts: `count` of them.
        """
        moves = []
        for number, contact in enumerate(contacts):
            start, stop = self.pressed(number)
            before, there, leave = start - WAIT - APPROACH, start - WAIT, stop + RETREAT
            away = contact.retreated(self.stand_off)
            moves += [
                Move(before - self.transfer, before, away, contact.q_WE),
                Move(before, there, contact.p_WE, contact.q_WE),
                Move(stop, leave, away, contact.q_WE),
            ]
        ramps = [ramp for number in range(self.count) for ramp in press(*self.pressed(number), self.force)]
        motion = Sampled(rest_to_rest(*hover_tool, moves))
        return Together([WithFlags(motion, {"calibrate": CALIBRATE}), Sampled(ForceProfile(ramps))])


@dataclass(frozen=True)
class Contact:
    """How one contact went.

    Attributes:
        held: the tip stayed on the surface in every row of the judged time, within 5 cm across of its set-point, the
            tool within 10 degrees of the desired attitude.
        force: true force along the surface's normal in the judged time, N, shape (n,).
        band: the same behind the filter of 5 Hz.
        across: error of the tool square to its desired axis, m, shape (n, 2), and
        attitude: angle to its desired attitude, rad, shape (n,), both in the judged time.
        peak: largest true force while the tool comes, stays and leaves, N.
        airborne: share of the judged time without contact.
    """

    held: bool
    force: Array
    band: Array
    across: Array
    attitude: Array
    peak: float
    airborne: float


def judge(log: Mapping[str, Array], series: ContactSeries, number: int, last: float) -> Contact:
    """Judge one contact by the last seconds in which its whole force is wanted.

    Args:
        log: columns of a run, at any rate.
        series: what was flown.
        number: of the contact.
        last: how long before the ramp down the judged time begins, s.
    """
    time, stop = log["time"][:, 0], series.held(number)[1]
    start, leave = series.pressed(number)
    rows = (time >= stop - last) & (time < stop)
    force = push_force(log)
    band = in_band(force, float(time[1] - time[0]))[rows]
    across, attitude = tool_errors({name: log[name][rows] for name in ("p_WE", "p_WE_d", "q_WE", "q_WE_d")})
    airborne = float((force[rows] <= 0.0).mean())
    placed = np.linalg.norm(across, axis=1).max() < NEAR and attitude.max() < UPRIGHT
    around = (time >= start - WAIT - APPROACH) & (time < leave + RETREAT)
    return Contact(
        bool(airborne == 0.0 and placed), force[rows], band, across, attitude, float(force[around].max()), airborne
    )


def tool_errors(log: Mapping[str, Array]) -> tuple[Array, Array]:
    """Error of the tool along its desired x and y, m, shape (rows, 2), and its angle to the desired attitude, rad."""
    desired = Rotation.from_quat(log["q_WE_d"], scalar_first=True)
    across = desired.inv().apply(log["p_WE"] - log["p_WE_d"])[:, :2]
    turned = desired.inv() * Rotation.from_quat(log["q_WE"], scalar_first=True)
    return across, np.asarray(turned.magnitude())
