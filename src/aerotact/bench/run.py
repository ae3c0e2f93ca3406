"""Run: the race. Every peer solves every sample in one process, by turns, so that what disturbs one disturbs all.

A race has a warm-up, then `passes` passes over the recorded samples; each peer begins a pass afresh. A machine that
does other work as well makes single samples slow whatever is computed, so the time of a sample is its smallest over the
passes, of those in which the system did not take the processor away if there is one; percentiles over all passes as
they were are kept beside ("raw"). Accuracy is judged in a pass of its own that is not timed.
"""

import resource
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from aerotact.bench.peers.acados_peer import FORMS, AcadosPeer, Setting, acados_template, settings
from aerotact.bench.peers.aerotact_peer import AerotactPeer
from aerotact.bench.peers.casadi_peer import CasadiPeer, error_of_one_iteration
from aerotact.bench.peers.osqp_peer import OsqpPeer
from aerotact.bench.peers.peer import Absent, Answer, Peer
from aerotact.bench.problems import Problem
from aerotact.bench.qp import Linearisation, Residuals
from aerotact.bench.reference import solve_exactly
from aerotact.bench.scenario import Sample
from aerotact.ports import Array

KINDS = ("aerotact", "single", "acados", "hpipm", "osqp", "casadi", "ipopt")
WARM_UP = 10
QUALIFYING = 100
Progress = Callable[[int, int, str], None]
"""(done, total, what)."""


@dataclass
class Record:
    """What one peer did.

    Attributes:
        peer: who.
        index: samples it saw, shape (n,).
        prepare, feedback, total: microseconds, shape (passes, n).
        interrupted: whether the processor was taken away meanwhile, the same shape.
        parts: further times by name, the same shape.
        work: factorisations, the same shape; NaN where not known.
        usable: share of answers that the solver calls usable.
        error: of the first control by the control's range, against the exact solution of the Qp that it was given,
            shape (n,); empty where it was not judged.
        residuals: one row (stationarity, feasibility, complementarity) a sample, shape (n, 3).
        remaining: IPOPT only: what one exact iteration leaves, shape (n,).
    """

    peer: Peer
    index: Array
    prepare: Array
    feedback: Array
    total: Array
    interrupted: Array
    parts: dict[str, Array] = field(default_factory=dict)
    work: Array = field(default_factory=lambda: np.zeros((0, 0)))
    usable: float = float("nan")
    error: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    remaining: Array = field(default_factory=lambda: np.zeros(0))

    def quiet_of(self, times: Array) -> Array:
        """Of times (passes, n) the smallest of each sample, of passes without interruption if there is one; (n,)."""
        whole = np.where(self.interrupted & ~self.interrupted.all(axis=0), np.inf, times)
        return np.array(whole.min(axis=0))

    @property
    def quiet(self) -> Array:
        """Microseconds of each sample, undisturbed, shape (n,)."""
        return self.quiet_of(self.total)

    @property
    def disturbed(self) -> float:
        """Share of samples that were interrupted in every pass."""
        return float(self.interrupted.all(axis=0).mean())


@dataclass(frozen=True)
class Race:
    """A race on one problem.

    Attributes:
        problem: what was raced on.
        samples: recorded.
        passes: timed ones.
        records: by the peer's name.
        skipped: one line for each peer that could not race.
        qualified: microseconds of each acados setting on the first samples.
    """

    problem: Problem
    samples: Sequence[Sample]
    passes: int
    records: dict[str, Record]
    skipped: tuple[str, ...]
    qualified: dict[str, Array] = field(default_factory=dict)

    @property
    def best_acados(self) -> Record | None:
        """acados at the setting with the smallest median."""
        found = [r for name, r in self.records.items() if name.startswith("acados")]
        return min(found, key=lambda r: float(np.median(r.quiet)), default=None)


def make_peers(
    problem: Problem, only: Sequence[str] | None = None, acados: Sequence[Setting] | None = None
) -> tuple[list[Peer], list[str]]:
    """Peers that are here, and a line for each that is not.

    Args:
        problem: what they solve.
        only: of KINDS; all if None.
        acados: settings to try; those of `settings` if None.
    """
    makers: list[tuple[str, Callable[[], Peer]]] = [("aerotact", lambda: AerotactPeer(problem, fresh=True))]
    skipped = []
    try:
        if only is None or "acados" in only:
            acados_template()
            makers += [
                ("acados", partial(AcadosPeer, problem, s)) for s in acados or settings(problem.transcription.steps)
            ]
    except Absent as absent:
        skipped.append(str(absent))
    makers += [
        ("single", lambda: AerotactPeer(problem, precision="single")),
        ("hpipm", lambda: AerotactPeer(problem, "hpipm", tolerance=1e-6)),
        ("hpipm", lambda: AerotactPeer(problem, "hpipm", tolerance=1e-8)),
        ("osqp", lambda: OsqpPeer(problem, 1e-3)),
        ("osqp", lambda: OsqpPeer(problem, 1e-5)),
        ("casadi", lambda: CasadiPeer(problem, "qrqp")),
        ("casadi", lambda: CasadiPeer(problem, "daqp")),
        ("ipopt", lambda: CasadiPeer(problem, "ipopt")),
    ]
    peers: list[Peer] = []
    for kind, make in makers:
        if only is not None and kind not in only:
            continue
        try:
            peers.append(make())
        except Absent as absent:
            if str(absent) not in skipped:
                skipped.append(str(absent))
    return peers, skipped


def race(
    problem: Problem,
    samples: Sequence[Sample],
    peers: Sequence[Peer],
    passes: int = 3,
    skipped: Sequence[str] = (),
    qualified: Mapping[str, Array] | None = None,
    progress: Progress = lambda done, total, what: None,
) -> Race:
    """Time every peer on every sample, the slow ones on some and after the others; then judge accuracy."""
    records = _time(samples, [p for p in peers if p.every == 1], passes, progress)
    records |= _time(samples, [p for p in peers if p.every > 1], 1, progress)
    for count, record in enumerate(records.values()):
        progress(count, len(records), f"accuracy of {record.peer.name}")
        _judge(problem, samples, record)
    return Race(problem, samples, passes, records, tuple(skipped), dict(qualified or {}))


def qualify(
    samples: Sequence[Sample], peers: Sequence[Peer], progress: Progress = lambda done, total, what: None
) -> tuple[list[Peer], dict[str, Array]]:
    """Leave acados' fastest setting of each form, so that the others do not fill the caches of the race.

    Returns:
        The peers that race, and the microseconds (n,) of every setting that was tried.
    """
    tried = [p for p in peers if isinstance(p, AcadosPeer)]
    if len({p.form for p in tried}) < len(FORMS):
        return list(peers), {}
    records = _time(samples[:QUALIFYING], tried, 3, progress)
    times = {name: record.quiet for name, record in records.items()}
    best = {form: min((p for p in tried if p.form == form), key=lambda p: np.median(times[p.name])) for form in FORMS}
    return [p for p in peers if not isinstance(p, AcadosPeer) or p is best[p.form]], times


def _time(samples: Sequence[Sample], peers: Sequence[Peer], passes: int, progress: Progress) -> dict[str, Record]:
    """Records without accuracy."""
    rows: dict[str, list[list[tuple[Answer, bool]]]] = {p.name: [] for p in peers}
    _warm_up(peers, samples)
    for number in range(passes if peers else 0):
        report = partial(_report, progress, len(samples), f"pass {number + 1}")
        for name, answers in _one_pass(peers, samples, report).items():
            rows[name].append(answers)
    return {p.name: _record(p, np.arange(0, len(samples), p.every), rows[p.name]) for p in peers}


def _report(progress: Progress, total: int, what: str, done: int) -> None:
    progress(done, total, what)


def _warm_up(peers: Sequence[Peer], samples: Sequence[Sample]) -> None:
    for sample in samples[:WARM_UP]:
        for peer in peers:
            if peer.every == 1:
                peer.solve(sample, full=False)


def _one_pass(
    peers: Sequence[Peer], samples: Sequence[Sample], progress: Callable[[int], None]
) -> dict[str, list[tuple[Answer, bool]]]:
    """Answers of every peer, and whether the system took the processor away meanwhile."""
    answers: dict[str, list[tuple[Answer, bool]]] = {p.name: [] for p in peers}
    for peer in peers:
        peer.reset()
    for i, sample in enumerate(samples):
        for turn in range(len(peers)):
            peer = peers[(turn + i) % len(peers)]
            if i % peer.every == 0:
                before = _interruptions()
                answer = peer.solve(sample, full=False)
                answers[peer.name].append((answer, _interruptions() != before))
        progress(i + 1)
    return answers


def _interruptions() -> int:
    """How often the system has taken the processor from this thread; 0 where it does not tell."""
    who = getattr(resource, "RUSAGE_THREAD", None)
    return 0 if who is None else resource.getrusage(who).ru_nivcsw


def _record(peer: Peer, index: Array, rows: list[list[tuple[Answer, bool]]]) -> Record:
    def gather(value: Callable[[Answer], float]) -> Array:
        return np.array([[value(answer) for answer, _ in row] for row in rows])

    return Record(
        peer=peer,
        index=index,
        prepare=gather(lambda a: a.prepare),
        feedback=gather(lambda a: a.feedback),
        total=gather(lambda a: a.total),
        interrupted=np.array([[flag for _, flag in row] for row in rows]),
        parts={key: gather(lambda a, key=key: a.parts[key]) for key in rows[0][0][0].parts},  # type: ignore[misc]
        work=gather(lambda a: a.work),
        usable=float(gather(lambda a: float(a.usable)).mean()),
    )


def _judge(problem: Problem, samples: Sequence[Sample], record: Record) -> None:
    """Errors and residuals of a peer's answers, each for the Qp that it was given."""
    linearise = Linearisation(problem.transcription, problem.parameters)
    errors, residuals, remaining = [], [], []
    record.peer.reset()
    for i in record.index:
        sample = samples[int(i)]
        answer = record.peer.solve(sample)
        if record.peer.name == "ipopt":
            remaining.append(error_of_one_iteration(sample, answer.u0, problem.control_range))
            continue
        exact = sample.reference
        if answer.own is not None:
            exact = solve_exactly(answer.own, sample.reference.active)
        wanted = sample.first_control(exact.solution.u)
        errors.append(float(np.abs((answer.u0 - wanted) / problem.control_range).max()))
        if answer.solution is not None:
            qp = answer.own or linearise(sample.x, sample.u, sample.stages, sample.measured)
            found: Residuals = qp.residuals(answer.solution)
            residuals.append([found.stationarity, found.feasibility, found.complementarity])
    record.error, record.remaining = np.array(errors), np.array(remaining)
    record.residuals = np.array(residuals).reshape(-1, 3)
