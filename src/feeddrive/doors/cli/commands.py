"""The commands, each a thin door to one function downstairs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Feed drives of machine tools: from a machine file or a measured log to a servo loop that is proven.",
)

Out = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", help="Directory to write; one that feeddrive wrote before is replaced.", show_default=False
    ),
]


def _version(wanted: bool) -> None:
    if wanted:
        from feeddrive import __version__

        typer.echo(f"feeddrive {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options that stand before a command."""


@app.command()
def run(
    job: Annotated[str, typer.Argument(help="A job file (TOML), or the name of a bundled job.")],
    log: Annotated[
        Path | None,
        typer.Option("--log", help="A measured log (MAT, CSV, Parquet) in place of the one that the job names."),
    ] = None,
    out: Out = None,
) -> None:
    """Run the laws of a job over the same work and write a report, a summary and the signals."""
    from feeddrive.doors.cli.working import perform

    perform(job, log, out or Path("results") / Path(job).stem)


@app.command()
def demo(out: Out = None) -> None:
    """Run the bundled example: a real ball-screw axis under today's control and under three better ones."""
    from feeddrive.doors.cli.working import perform

    perform("emps", None, out or Path("results") / "demo")


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(help="altintas2009, gordon2013, beltran2013, wu2017, or all.")],
    out: Out = None,
) -> None:
    """Run a paper's experiments and write what it claims, by which rule, and what came out; 1 if a claim fails."""
    from feeddrive.doors.cli.reproduce import perform

    perform(paper, out)


@app.command()
def prefilter(
    log: Annotated[Path, typer.Argument(help="A log of set position and position (MAT, CSV, Parquet).")],
    regressors: Annotated[
        str, typer.Option("--regressors", help="Which derivatives of the reference may be used.")
    ] = "v,a,j,s",
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller", help="The machine file of the loop: its clock, limit and prefilter.", show_default=False
        ),
    ] = None,
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    job: Annotated[
        str | None,
        typer.Option("--job", help="The job whose reference was run, for exact derivatives.", show_default=False),
    ] = None,
    set_position: Annotated[
        str | None, typer.Option("--set-position", help="Column of the set position.", show_default=False)
    ] = None,
    position: Annotated[
        str | None, typer.Option("--position", help="Column of the position of the table.", show_default=False)
    ] = None,
    force: Annotated[
        str | None, typer.Option("--force", help="Column of the commanded force.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File for the section (TOML).", show_default=False)
    ] = None,
) -> None:
    """Fit the prefilter that cancels what a loop leaves of its tracking error, from one log."""
    from feeddrive.doors.cli.prefilter import perform

    columns = {"setpoint_position": set_position, "position_load": position, "force": force}
    perform(log, regressors, controller, axis, job, columns, out)


@app.command()
def compare(
    machine: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    axis: Annotated[str | None, typer.Option("--axis", help="The axis, if the machine has several.")] = None,
    out: Out = None,
) -> None:
    """Put all laws on one axis, tuned to equal robustness, beside today's gains, and rank them by criterion."""
    from feeddrive.doors.cli.compare import perform

    perform(machine, axis, out)
