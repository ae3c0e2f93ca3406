"""Random shapes of OCP QPs: dimensions, bounded states, general and soft rows, and the structure of A and B."""

from dataclasses import dataclass

import numpy as np

from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern
from aerotact.ports import Array

LARGEST = (40, 16, 50)  # states, controls, intervals


@dataclass(frozen=True)
class Shape:
    """A pattern, and what the entries of A and B are that data must respect: NaN free, else the value.

    A one in `fixed_B` stands for an integrator's entry, which is the interval's length.
    """

    pattern: QpPattern
    fixed_A: Array | None = None
    fixed_B: Array | None = None


def random_shape(rng: np.random.Generator, large: bool) -> Shape:
    """Any of the sizes if `large`, else up to 15 states, 6 controls and 25 intervals; half of them structured."""
    nx = int(rng.integers(2, LARGEST[0] + 1 if large else 16))
    nu = int(rng.integers(1, LARGEST[1] + 1 if large else 7))
    steps = int(rng.integers(5, LARGEST[2] + 1 if large else 26))
    bounded = set(rng.choice(nx, int(rng.integers(0, nx + 1)), replace=False).tolist())
    general = int(rng.integers(0, 4)) if rng.random() < 0.5 else 0
    fixed_A = fixed_B = None
    if rng.random() < 0.5:
        fixed_A, fixed_B, integrated = _structure(rng, nx, nu)
        if rng.random() < 0.7:
            bounded |= set(integrated)
    soft = rng.choice([0.0, 0.3, 1.0])
    pattern = QpPattern(
        nx,
        nu,
        steps,
        bounded=tuple(sorted(bounded)),
        general=general,
        soft_bounds=tuple(bool(rng.random() < soft) for _ in bounded),
        soft_rows=tuple(bool(rng.random() < soft) for _ in range(general)),
        A=None if fixed_A is None else _pattern(fixed_A, one=ONE),
        B=None if fixed_B is None else _pattern(fixed_B, one=FREE),
    )
    return Shape(pattern, fixed_A, fixed_B)


def _structure(rng: np.random.Generator, nx: int, nu: int) -> tuple[Array, Array, list[int]]:
    """Zeros anywhere; some states are integrators, delays (no identity) or constants (no control)."""
    A = np.where(rng.random((nx, nx)) < 0.3, 0.0, np.nan)
    B = np.where(rng.random((nx, nu)) < 0.3, 0.0, np.nan)
    states = rng.permutation(nx)[: int(rng.integers(1, min(nx, nu) + 1))]
    for state, control in zip(states, rng.permutation(nu), strict=False):
        A[state] = B[state] = 0.0
        A[state, state] = 1.0 if rng.random() < 0.9 else 0.0
        B[state, control] = 1.0 if rng.random() < 0.9 else 0.0
    return A, B, states.tolist()


def _pattern(fixed: Array, one: int) -> list[list[int]]:
    return np.where(np.isnan(fixed), FREE, np.where(fixed == 1.0, one, ZERO)).tolist()
