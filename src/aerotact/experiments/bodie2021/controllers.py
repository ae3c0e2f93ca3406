"""Controllers of bodie2021's experiments: the paper's gains (Table IV), the same law tuned, and an MPC."""

from collections.abc import Mapping

from aerotact.experiments.experiment import ControllerSpec, Parameters

LAW, RATE = "bodie2021_impedance_force", 200.0
"""The law and its rate, Hz: not printed; with 200 Hz the c_lambda of Table IV is a time constant of 0.5 s."""

MPC = "tilt_rotor_force"

# Table IV. Its groups of gains: A and D; B, C, E and F. K_I is 3 in B, C and D, 1 in A, E and F. Masses of A: Table V.
_AD = {"K_lin": 130.0, "D_lin": 40.0, "K_ang": 9.0, "D_ang": 3.0}
_BCEF = {"K_lin": 100.0, "D_lin": 35.0, "K_ang": 3.5, "D_ang": 1.2}
_SPANS_AD = {"d_min": 0.02, "d_max": 0.2, "e_min": 0.2, "e_max": 0.25}
_SPANS_BCEF = {"d_min": 0.2, "d_max": 0.4, "e_min": 0.15, "e_max": 0.25}
_FORCE = {"K_fp": 0.1, "K_fi": 1.0, "confidence_time": 0.5}
_SLOW, _FAST = {"K_I_lin": 1.0, "K_I_ang": 1.0}, {"K_I_lin": 3.0, "K_I_ang": 3.0}


def _masses(wall: float) -> dict[str, float]:
    return {"m_wall": wall, "m_free": 5.0, "J_v": 5.0}


TABLE_IV: dict[str, dict[str, float]] = {
    "A": {**_AD, **_FORCE, **_masses(0.25), **_SLOW, **_SPANS_AD},
    "B": {**_BCEF, **_FORCE, **_masses(0.5), **_FAST, **_SPANS_BCEF},
    "C": {**_BCEF, **_FORCE, **_masses(0.5), **_FAST, **_SPANS_BCEF},
    "D": {**_AD, **_FORCE, **_masses(0.25), **_FAST, **_SPANS_AD},
    "E": {**_BCEF, **_FORCE, **_masses(0.5), **_SLOW, **_SPANS_BCEF},
    "F": {**_BCEF, **_FORCE, **_masses(0.5), **_SLOW, **_SPANS_BCEF},
}
"""Experiment's letter -> the law's parameters as the paper has them."""

TUNED: dict[str, float] = {
    "K_lin": 300.0,
    "D_lin": 60.0,
    "K_ang": 15.0,
    "D_ang": 3.0,
    "K_I_lin": 10.0,
    "K_I_ang": 6.0,
    "m_free": 20.0,
    "J_v": 20.0,
    "K_fp": 1.0,
    "K_fi": 10.0,
    "force_cutoff": 40.0,
    "approach_speed": 0.004,
    "approach_slope": 1.0,
    "approach_release": 3.0,
}
"""What the tuned law has instead: the approach as slow as the MPC's, gains as high as noise and lag allow."""


def controllers(
    letter: str,
    tuned: Parameters | None = None,
    mpc: Parameters | None = None,
    law: Parameters | None = None,
    estimators: Mapping[str, Parameters] | None = None,
) -> dict[str, ControllerSpec]:
    """The two laws and the MPC for one of the paper's experiments.

    Args:
        letter: A to F, the experiment whose row of Table IV counts.
        tuned, mpc, law: parameters of theirs that this experiment sets.
        estimators: estimator -> parameters that go with the MPC.
    """
    paper = {**TABLE_IV[letter], **(law or {})}
    high = {**paper, **TUNED, **(tuned or {})}
    return {
        "law": ControllerSpec(LAW, RATE, f"the paper's law with its gains of Table IV, experiment {letter}", paper),
        "law-tuned": ControllerSpec(LAW, RATE, "the same law: higher gains and a limit of the approach's speed", high),
        "mpc": ControllerSpec(MPC, None, "hybrid force and pose control under limits", mpc or {}, estimators or {}),
    }
