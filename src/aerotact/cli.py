"""Command line: list, check, generate, fly, compare, bench.

Exit codes: 0 done; 1 a check or a run failed; 2 a name or an argument is wrong; 3 the robot folder; 4 the ocp file;
5 code generation or compiling; 6 the loop; 130 interrupted.
"""

import json
import os
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.markup import escape
from rich.table import Table

from aerotact import __version__
from aerotact.exceptions import AerotactError, InputError
from aerotact.terminal import console, errors, make_folder, progress_bar, say, write

if TYPE_CHECKING:
    from aerotact.flight import Options

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="From the MuJoCo model of an aerial robot to standalone C controllers for touching the world.",
)
_OPENGL = os.environ.get("MUJOCO_GL", "").strip().lower()  # as the user wants it
_NO_OPENGL = ("disabled", "disable", "off", "false", "0")  # in MuJoCo's words

RobotOption = Annotated[str | None, typer.Option("--robot", "-r", help="Name or folder of the robot.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Also write the numbers to this file.")]
TruthOption = Annotated[bool, typer.Option("--truth", help="Give the controller the true state of the base.")]
DelayOption = Annotated[str, typer.Option("--delay", help="Seconds from measurement to command, or 'measured'.")]
OutputOption = Annotated[Path, typer.Option("--output", "-o", help="Folder for logs, plots and pages.")]


def main() -> None:
    """Entry point: errors of aerotact become one line and an exit code."""
    # Only the process that takes a picture needs OpenGL, and MuJoCo cannot be imported where MUJOCO_GL names a backend
    # that is missing.
    os.environ["MUJOCO_GL"] = _NO_OPENGL[0]
    try:
        app()
    except AerotactError as error:
        errors.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True)
        sys.exit(error.exit_code)
    except OSError as error:
        errors.print(f"[bold red]error:[/] {escape(str(error))}", soft_wrap=True)
        sys.exit(1)


def _version(value: bool) -> None:
    if value:
        console.print(f"aerotact {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    pass


@app.command("list")
def list_all() -> None:
    """Show robots, laws, estimators, problems and experiments.

    Example: `aerotact list`
    """
    from aerotact.estimation import estimators
    from aerotact.experiments import experiments
    from aerotact.laws import laws
    from aerotact.resources import problem_files, robot_folders

    table = Table("kind", "name", "where or what")
    for name, folder in robot_folders().items():
        table.add_row("robot", name, str(folder))
    for kind, builders in (("law", laws()), ("estimator", estimators())):
        for name, build in builders.items():
            table.add_row(kind, name, str(build.__doc__).splitlines()[0])
    for name, file in problem_files().items():
        table.add_row("problem", name, str(file))
    for name, experiment in experiments().items():
        table.add_row("experiment", name, experiment.doc)
    console.print(table)


@app.command()
def check(
    folder: Annotated[str, typer.Argument(help="Folder or name of a robot.")],
    json_file: JsonOption = None,
) -> None:
    """Check a robot folder: loads, trims, CasADi = MuJoCo, allocation, limits, sensors, laws and problems that fit.

    Example: `aerotact check models/my_robot`
    """
    from aerotact.check import check_robot

    report = check_robot(folder)
    table = Table("", "check", "found", title=f"robot {report.robot}")
    for item in report.items:
        table.add_row("[green]ok[/]" if item.passed else "[red]fails[/]", item.name, escape(item.detail))
    console.print(table)
    if report.fits:
        say(f"fits: {', '.join(report.fits)}")
    for misfit in report.misfits:
        say(f"does not fit: {misfit}")
    if json_file is not None:
        content = {
            "robot": report.robot,
            "passed": report.passed,
            "items": [vars(item) for item in report.items],
            "fits": report.fits,
            "misfits": report.misfits,
        }
        write(json_file, json.dumps(content, indent=2) + "\n")
    if not report.passed:
        raise typer.Exit(1)


@app.command()
def generate(
    name: Annotated[str, typer.Argument(help="A law, an estimator, or an ocp file by name or path.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the C project.")],
    robot: Annotated[str, typer.Option("--robot", "-r", help="Name or folder of the robot.")],
    rate: Annotated[float | None, typer.Option(help="Hz of a law or an estimator; 500 if not given.")] = None,
    precision: Annotated[
        str | None, typer.Option(help="double, or single for floats; of an MPC, its file's own if not given.")
    ] = None,
) -> None:
    """Write a standalone C project: header, sources, example, Makefile, CMakeLists.txt, manifest.

    It is also compiled here, into the cache, if there is a compiler, for the sizes in the manifest.

    Examples: `aerotact generate ocp/my_problem.toml --robot models/my_robot -o my_mpc`,
    `aerotact generate ryll2019_admittance --robot models/my_robot --rate 250 -o my_law`
    """
    from aerotact.codegen.build import measured
    from aerotact.codegen.precision import PRECISIONS
    from aerotact.dynamics.model_of import model_of
    from aerotact.exceptions import CodegenError, UnknownName
    from aerotact.flight import controller_project
    from aerotact.robot import load_robot

    if rate is not None and not 1.0 <= rate <= 1e5:
        raise InputError(f"--rate is {rate:g} Hz; valid: 1 to 100000 Hz")
    if precision is not None and precision not in PRECISIONS:
        raise UnknownName("precision", precision, PRECISIONS, "--precision")
    begin = perf_counter()
    project = controller_project(name, model_of(load_robot(robot)), rate, precision=precision)
    generated = perf_counter()
    if rate is not None and abs(project.manifest["rate_hz"] - rate) > 1e-9:
        raise InputError(
            f"--rate is {rate:g} Hz, but '{name}' runs at {project.manifest['rate_hz']:g} Hz, set in its ocp file"
        )
    project.write(output)
    size = sum(len(text) for text in project.files.values())
    say(f"wrote {len(project.files)} files, {size / 1024:.0f} KiB, to {output}, in {generated - begin:.1f} s")
    try:
        project = measured(project)
    except CodegenError as error:
        say(f"not compiled, so no sizes in its manifest: {str(error).splitlines()[0]}")
    else:
        project.write(output)
        found = project.manifest["footprint"]
        sizes = ", ".join(f"{k} {found[f'{k}_bytes']}" for k in ("code", "data", "workspace", "stack"))
        say(f"bytes, {found['compiler']}: {sizes}; compiled in {perf_counter() - generated:.1f} s")
    say(f"build and run its example:  make -C {output} run")


@app.command()
def fly(
    experiment: Annotated[str, typer.Argument(help="Name of the experiment, paper/experiment.")],
    controller: Annotated[str, typer.Option("--controller", "-c", help="law, law-tuned, mpc, or any law or ocp file.")],
    case: Annotated[str | None, typer.Option(help="Case of the experiment; its first one if not given.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sensors.")] = 0,
    robot: RobotOption = None,
    truth: TruthOption = False,
    delay: DelayOption = "0",
    output: OutputOption = Path("results"),
) -> None:
    """Fly one closed loop: log, plots, picture.

    Example: `aerotact fly ryll2019/free-flight --controller mpc`
    """
    from aerotact.exceptions import UnknownName
    from aerotact.experiments import find_experiment
    from aerotact.flight import fly as fly_case
    from aerotact.log import read_columns

    found = find_experiment(experiment)
    cases = {c.name: c for c in found.cases}
    chosen = cases.get(case) if case is not None else found.cases[0]
    if chosen is None:
        raise UnknownName("case", str(case), cases, experiment)
    folder = output / experiment
    with progress_bar() as progress:
        task = progress.add_task(f"{controller} {chosen.name}", total=chosen.duration)
        log, result = fly_case(
            found,
            chosen,
            controller,
            seed,
            _flight_options(robot, truth, delay, folder),
            lambda t: progress.update(task, completed=t),
        )
        progress.update(task, completed=chosen.duration)
    table = Table("metric", "value", "unit", title=f"{experiment} {chosen.name}, {controller}, seed {seed}")
    for name, metric in result.metrics.items():
        if metric.value is not None:
            table.add_row(name, f"{metric.value:.4g}", metric.unit)
    console.print(table)
    for block, statuses in {"controller": log.statuses, **log.inner_statuses, **log.estimator_statuses}.items():
        say(f"steps of {block}: {', '.join(f'{count} {status}' for status, count in statuses.items())}")
    if result.file is not None:
        say(f"log:     {result.file}")
        if not result.fault:
            runs = {(result.controller, chosen.name): read_columns(result.file)}
            for figure in found.plot(runs, folder / result.controller):
                say(f"plot:    {figure}")
    _picture(robot or chosen.robot or found.robot, folder)
    if result.fault:
        errors.print(f"[bold red]ended early:[/] {escape(result.fault)}; the log holds what was flown", soft_wrap=True)
        raise typer.Exit(6)


@app.command()
def compare(
    experiment: Annotated[str, typer.Argument(help="Name of the experiment, paper/experiment.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="How many seeds; the experiment's own if not given.")] = None,
    controllers: Annotated[
        list[str] | None, typer.Option("--controller", "-c", help="Only these; may be repeated.")
    ] = None,
    cases: Annotated[list[str] | None, typer.Option("--case", help="Only these; may be repeated.")] = None,
    robot: RobotOption = None,
    truth: TruthOption = False,
    delay: DelayOption = "0",
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Processes.")] = 2,
    output: OutputOption = Path("results"),
    json_file: JsonOption = None,
) -> None:
    """Fly every controller on the same plant with the same seeds; print the table beside the paper, plot, write a page.

    Example: `aerotact compare ryll2019/property-shaping --seeds 1`
    """
    from aerotact.compare import comparison_table, first_seed_logs, run_comparison
    from aerotact.exceptions import UnknownName
    from aerotact.experiments import find_experiment
    from aerotact.log import read_columns
    from aerotact.report import write_report

    found = find_experiment(experiment)
    known = [c.name for c in found.cases]
    for name in cases or []:
        if name not in known:
            raise UnknownName("case", name, known, experiment)
    folder = output / experiment
    options = _flight_options(robot, truth, delay, folder)
    with progress_bar() as progress:
        task = progress.add_task("", total=None)
        comparison = run_comparison(
            found,
            range(seeds or found.seeds),
            options,
            controllers or None,
            cases or None,
            jobs,
            lambda done, total, what: progress.update(task, completed=done, total=total, description=what),
        )
    console.print(comparison_table(comparison))
    if truth:
        say("the controllers had the true state of the base, not an estimate")
    write(folder / "compare.json", comparison.to_json())
    if json_file is not None:
        write(json_file, comparison.to_json())
    runs = {key: read_columns(file) for key, file in first_seed_logs(comparison).items()}
    figures = found.plot(runs, folder) if runs else []
    for figure in figures:
        say(f"plot:    {figure}")
    flown = [c.robot or found.robot for c in found.cases if not cases or c.name in cases]
    pictures = [_picture(name, folder) for name in dict.fromkeys([robot] if robot else flown)]
    page = write_report(comparison, found, [*(p for p in pictures if p), *figures], folder / "report.html")
    say(f"page:    {page}")
    say(f"numbers: {folder / 'compare.json'}")
    say(f"logs:    {folder}, one folder a controller")
    for fault in comparison.faults:
        errors.print(f"[bold red]ended early:[/] {escape(fault)}", soft_wrap=True)
    if comparison.faults:
        raise typer.Exit(6)


@app.command()
def bench(
    ocp: Annotated[str, typer.Option("--ocp", help="H, O, or an ocp file by name or path.")] = "H",
    samples: Annotated[int, typer.Option(min=20, help="Samples of the closed loop.")] = 600,
    passes: Annotated[int, typer.Option(min=1, help="Timed passes over them.")] = 5,
    horizon: Annotated[list[int] | None, typer.Option(min=1, help="Intervals for the growth; may be repeated.")] = None,
    solvers: Annotated[
        list[str] | None,
        typer.Option("--solver", "-s", help="aerotact, single, acados, hpipm, osqp, casadi, ipopt; may be repeated."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the steps of the reference.")] = 11,
    blocks: Annotated[
        list[str] | None, typer.Option(help="Robot whose laws and estimators are timed; may be repeated.")
    ] = None,
    json_file: JsonOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for page, numbers and plot.")] = Path(
        "results/bench"
    ),
) -> None:
    """Time the generated solver beside its peers on the same quadratic programmes; print tables, plot, write a page.

    acados is found through the variable ACADOS_SOURCE_DIR.

    Examples: `aerotact bench --ocp H`, `aerotact bench --ocp O --horizon 10 --horizon 40 --horizon 80`
    """
    from aerotact.bench.bench import Options, run_bench
    from aerotact.bench.report import accuracy_rows, page, plot, time_rows
    from aerotact.bench.run import KINDS
    from aerotact.exceptions import UnknownName

    for name in solvers or []:
        if name not in KINDS:
            raise UnknownName("solver", name, KINDS)
    options = Options(ocp, samples, passes, horizon or (), solvers or None, seed, blocks or ())
    make_folder(output)
    with progress_bar() as progress:
        task = progress.add_task("", total=None)
        race, summary = run_bench(
            options,
            lambda done, total, what: progress.update(task, completed=done, total=total, description=what),
        )
    for title, (header, rows), shown in (
        ("time, us", time_rows(summary), (0, 1, 2, 3, 5, 9)),
        ("accuracy", accuracy_rows(summary), (0, 1, 2, 3)),
    ):
        table = Table(*(header[i] for i in shown), title=f"{summary['ocp']}: {title}")
        for row in rows:
            table.add_row(*(row[i] for i in shown))
        for column in table.columns:
            column.no_wrap = True
        console.print(table)
    for name, ratio in summary["ratio_to_acados"].items():
        say(f"acados over aerotact, {name}: {ratio:.1f}")
    for line in summary["skipped"]:
        say(line)
    text = json.dumps(summary, indent=2) + "\n"
    figures = plot(race, summary, output)
    write(output / f"{summary['ocp']}.json", text)
    if json_file is not None:
        write(json_file, text)
    write(output / f"{summary['ocp']}.md", page(summary, figures))
    say(f"page:    {output / summary['ocp']}.md")


def _flight_options(robot: str | None, truth: bool, delay: str, folder: Path) -> "Options":
    from aerotact.flight import Options

    late: float | Literal["measured"]
    if delay == "measured":
        late = "measured"
    else:
        try:
            late = float(delay)
        except ValueError as error:
            raise InputError(f"--delay is '{delay}'; valid: seconds, or 'measured'") from error
        if not 0.0 <= late <= 1.0:
            raise InputError(f"--delay is {late:g} s; valid: 0 to 1 s")
    make_folder(folder)
    return Options(robot, truth, late, folder)


def _picture(robot: str, folder: Path) -> Path | None:
    from aerotact.plant.picture import render
    from aerotact.robot import load_robot

    if _OPENGL in _NO_OPENGL:
        say(f"no picture: MUJOCO_GL is '{_OPENGL}'")
        return None
    os.environ["MUJOCO_GL"] = _OPENGL
    loaded = load_robot(robot)
    picture = render(loaded, folder / f"{loaded.name}.png")
    say(f"picture: {picture.file}" if picture else picture.reason)
    return picture.file if picture else None


if __name__ == "__main__":
    main()
