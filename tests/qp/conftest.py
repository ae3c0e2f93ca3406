"""A shape with everything: integrators, a constant, bounded states, general rows, some of both soft."""

import numpy as np
import pytest
from shapes import Shape

from aerotact.codegen.qp_structure import FREE, ONE, ZERO, QpPattern


@pytest.fixture(scope="session")
def mixed() -> Shape:
    nx, nu, integrators, constant = 11, 4, 4, 8
    fixed_A = np.where(np.random.default_rng(5).random((nx, nx)) < 0.3, 0.0, np.nan)
    fixed_B = np.full((nx, nu), np.nan)
    for row in (*range(integrators), constant):
        fixed_A[row] = fixed_B[row] = 0.0
        fixed_A[row, row] = 1.0
        if row != constant:
            fixed_B[row, integrators - 1 - row] = 1.0
    pattern = QpPattern(
        nx,
        nu,
        steps=15,
        bounded=(0, 1, 2, 3, 7),
        general=2,
        soft_bounds=(False, False, False, False, True),
        soft_rows=(False, True),
        A=np.where(np.isnan(fixed_A), FREE, np.where(fixed_A == 1.0, ONE, ZERO)).tolist(),
        B=np.where(fixed_B == 0.0, ZERO, FREE).tolist(),
    )
    return Shape(pattern, fixed_A, fixed_B)


@pytest.fixture(scope="session")
def small() -> Shape:
    """Without structure: three bounded states of which one is soft, one hard general row."""
    return Shape(
        QpPattern(6, 2, 12, bounded=(0, 3, 5), general=1, soft_bounds=(False, True, False), soft_rows=(False,))
    )
