"""The MPC test set of qpbenchmark by the generated QP solver: success rates and times, as a Markdown table.

    python benchmarks/mpc_qpbenchmark.py FOLDER

FOLDER holds the .npz files of https://github.com/qpsolvers/mpc_qpbenchmark (`data/`; Apache License 2.0), which are not
part of this repository. Each problem is solved once from a cold start: LIPMWALK and WHLIPBAL, which have lost their
states, as one stage whose controls are the variables; QUADCMPC as the horizon that it is.
A problem counts as solved at a tolerance if its primal residual, dual residual and duality gap, as qpbenchmark defines
them (absolute, largest entry), are below it and the solver says OK.
"""

import argparse
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerotact.ports import Array
from aerotact.qp.dense import dense_qp
from aerotact.qp.programme import DenseProgramme, DenseSolution
from aerotact.qp.solver import QpSolver, QpStatus
from aerotact.qp.staged import staged_qp

STAGES = {"QUADCMPC": (12, 12)}  # states and controls of the families that kept their states
TOLERANCES = (1e-3, 1e-6, 1e-9)


@dataclass(frozen=True)
class Row:
    """One problem: family, solution, seconds of the solve."""

    family: str
    solution: DenseSolution
    seconds: float


def load(file: Path) -> dict[str, Array]:
    """P, q, G, h, A, b, lb, ub, as far as the file has them."""
    found = {}
    with np.load(file, allow_pickle=False) as archive:
        for name in ("P", "q", "G", "h", "A", "b", "lb", "ub"):
            try:
                found[name] = archive[name]
            except (KeyError, ValueError):  # not there, or a pickled None
                continue
    return found


def solve(file: Path) -> Row:
    """Solve one problem from a cold start."""
    family = re.sub(r"\d+$", "", file.stem)
    programme = DenseProgramme.of(**load(file))
    problem = staged_qp(programme, *STAGES[family]) if family in STAGES else dense_qp(programme)
    solver = QpSolver(problem.pattern)
    solver.write(problem.data)
    start = time.perf_counter()
    found = solver.solve()
    seconds = time.perf_counter() - start
    return Row(family, problem.recover(found), seconds)


def table(rows: list[Row]) -> str:
    """Families in rows."""
    head = ["family", "problems", *(f"solved at {t:g}" for t in TOLERANCES), "primal", "dual", "gap", "median", "max"]
    lines = [head, ["---"] * len(head)]
    for family in sorted({r.family for r in rows}):
        own = [r for r in rows if r.family == family]
        solved = [
            f"{sum(r.solution.within(t) and r.solution.status is QpStatus.OK for r in own)}/{len(own)}"
            for t in TOLERANCES
        ]
        worst = [f"{max(getattr(r.solution, name) for r in own):.1e}" for name in ("primal", "dual", "gap")]
        seconds = [r.seconds for r in own]
        times = [f"{1e3 * value:.3g} ms" for value in (np.median(seconds), max(seconds))]
        lines.append([family, str(len(own)), *solved, *worst, *times])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Solve every file of a folder and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="data/ of mpc_qpbenchmark")
    parser.add_argument("--family", default="", help="only files whose names begin so")
    arguments = parser.parse_args()
    files = sorted(arguments.folder.glob(f"{arguments.family}*.npz"))
    if not files:
        parser.error(f"{arguments.folder}: no .npz files; get data/ of https://github.com/qpsolvers/mpc_qpbenchmark")
    print(table([solve(file) for file in files]))


if __name__ == "__main__":
    main()
