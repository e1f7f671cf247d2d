"""The commands, each a thin door to one function downstairs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli import identify_command
from feeddrive.cli.certify_command import certify, check
from feeddrive.cli.cogging_command import cogging
from feeddrive.cli.cosimulate_command import cosimulate
from feeddrive.cli.export_command import export, verify
from feeddrive.cli.friction_command import friction
from feeddrive.cli.out import Out
from feeddrive.cli.play_command import listen, play
from feeddrive.cli.terminal import Commands
from feeddrive.cli.tune_command import tune
from feeddrive.cli.virtual_drive_command import virtual_drive

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Feed drives of machine tools: from a machine file or a measured log to a servo loop that is proven.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from feeddrive.version import __version__

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
    from feeddrive.cli.working import perform

    perform(job, log, out or Path("results") / Path(job).stem)


@app.command()
def demo(out: Out = None) -> None:
    """Run the bundled example: a real ball-screw axis under today's control and under three better ones."""
    from feeddrive.cli.working import perform

    perform("emps", None, out or Path("results") / "demo")


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(help="altintas2009, gordon2013, beltran2013, wu2017, or all.")],
    out: Out = None,
) -> None:
    """Run a paper's experiments and write what it claims, by which rule, and what came out; 1 if a claim fails."""
    from feeddrive.cli.reproduce import perform

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
    from feeddrive.cli.prefilter import perform

    columns = {"setpoint_position": set_position, "position_load": position, "force": force}
    perform(log, regressors, controller, axis, job, columns, out)


@app.command()
def compare(
    machine: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    axis: Annotated[str | None, typer.Option("--axis", help="The axis, if the machine has several.")] = None,
    law: Annotated[
        list[str] | None,
        typer.Option("--law", help="A law that is wanted; may be repeated. Default: all.", show_default=False),
    ] = None,
    starts: Annotated[int, typer.Option("--starts", min=1, max=20, help="Searches for each law; the best counts.")] = 2,
    out: Out = None,
) -> None:
    """Put all laws on one axis, tuned to equal robustness, beside today's gains, and rank them by criterion."""
    from feeddrive.cli.compare import perform

    perform(machine, axis, law, starts, out)


@app.command()
def iterate(
    source: Annotated[
        str,
        typer.Argument(help="A log of set position and position (MAT, CSV, Parquet), or a machine to simulate trials."),
    ],
    controller: Annotated[
        str | None,
        typer.Option("--controller", help="The machine file of the loop that ran the log.", show_default=False),
    ] = None,
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    form: Annotated[str, typer.Option("--form", help="model-free, model-based or axis-model.")] = "model-free",
    columns: Annotated[
        str | None,
        typer.Option("--columns", help="Parameters to tune, as mass,viscous,coulomb_positive.", show_default=False),
    ] = None,
    gamma: Annotated[float, typer.Option("--gamma", help="Share of the step; 0.5 if gains are known roughly.")] = 1.0,
    stribeck_velocity: Annotated[
        float | None,
        typer.Option("--stribeck-velocity", help="m/s; adds a Stribeck column.", show_default=False),
    ] = None,
    least_mass: Annotated[float, typer.Option("--least-mass", help="kg; the mass stays above it.")] = 0.0,
    skip: Annotated[int, typer.Option("--skip", help="Samples at the start of the log that do not count.")] = 0,
    smoothing: Annotated[
        int | None,
        typer.Option("--smoothing", help="Samples over which the set position is averaged.", show_default=False),
    ] = None,
    set_position: Annotated[
        str | None, typer.Option("--set-position", help="Column of the set position, name:unit.", show_default=False)
    ] = None,
    position: Annotated[
        str | None, typer.Option("--position", help="Column of the position of the table.", show_default=False)
    ] = None,
    force: Annotated[
        str | None, typer.Option("--force", help="Column of the commanded force.", show_default=False)
    ] = None,
    command: Annotated[
        str | None, typer.Option("--command", help="Column of the command in the drive's unit.", show_default=False)
    ] = None,
    trials: Annotated[int, typer.Option("--trials", help="Simulated trials.")] = 6,
    job: Annotated[
        list[str] | None,
        typer.Option("--job", help="Job whose reference the trials run; several take turns.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise of simulated trials.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File for the section (TOML).", show_default=False)
    ] = None,
) -> None:
    """Learn mass, viscous and dry friction to feed forward from the error of a trial: a log, or simulated ones."""
    from feeddrive.cli.iterate import Asked, perform_on_log, perform_trials

    asked = Asked(
        controller=source if controller is None else controller, axis=axis, form=form, gamma=gamma,
        columns=None if columns is None else tuple(each.strip() for each in columns.split(",") if each.strip()),
        stribeck_velocity=stribeck_velocity, least_mass=least_mass, out=out,
    )  # fmt: skip
    if controller is None:
        perform_trials(asked, trials, job or (), seed)
        return
    named = {"setpoint_position": set_position, "position_load": position, "force": force, "command": command}
    perform_on_log(Path(source), asked, named, skip, smoothing)


@app.command()
def frf(
    logs: Annotated[
        list[Path], typer.Argument(help="Logs of the same measurement (MAT, CSV, Parquet), one a realisation.")
    ],
    input_: Annotated[
        str | None, typer.Option("--input", help="Column of the input, name or name:unit.", show_default=False)
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option("--output", help="Column of an output, name or name:unit; may be repeated.", show_default=False),
    ] = None,
    reference: Annotated[
        list[str] | None,
        typer.Option("--reference", help="Column of what was added to the loop; none for no such.", show_default=False),
    ] = None,
    method: Annotated[
        str,
        typer.Option("--method", help="auto, periodic, local-polynomial, h1, h2, hv, indirect or joint."),
    ] = "auto",
    band: Annotated[str | None, typer.Option("--band", help="Hz, as 5..500.", show_default=False)] = None,
    period: Annotated[
        int | None, typer.Option("--period", help="Samples of one period; found if left out.", show_default=False)
    ] = None,
    skip: Annotated[
        int | None, typer.Option("--skip", help="Periods dropped at the start; by a test.", show_default=False)
    ] = None,
    segment: Annotated[
        int | None, typer.Option("--segment", help="Samples of a stretch of averaged spectra.", show_default=False)
    ] = None,
    sample_time: Annotated[
        float | None, typer.Option("--sample-time", help="s, for logs without time.", show_default=False)
    ] = None,
    time: Annotated[
        str | None, typer.Option("--time", help="Column of the time, name:unit.", show_default=False)
    ] = None,
    channels: Annotated[
        Path | None,
        typer.Option(
            "--channels", help="Which column is what (TOML), as `feeddrive channels` writes it.", show_default=False
        ),
    ] = None,
    out: Out = None,
) -> None:
    """Estimate a frequency response with coherence, variance, noise and distortion from measured logs."""
    from feeddrive.cli.frf import perform

    names = (input_, output or (), reference or ())
    perform(logs, *names, method, band, period, skip, segment, sample_time, out, channels, time)


@app.command()
def excite(
    machine: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    band: Annotated[str, typer.Option("--band", help="Hz, as 5..500.")],
    amplitude: Annotated[float, typer.Option("--amplitude", help="Peak: N on the force, m on the setpoint.")],
    axis: Annotated[str | None, typer.Option("--axis", help="The axis, if the machine has several.")] = None,
    where: Annotated[str, typer.Option("--where", help="force or setpoint.")] = "force",
    resolution: Annotated[float, typer.Option("--resolution", help="Hz from line to line.")] = 1.0,
    periods: Annotated[int, typer.Option("--periods", help="Periods in steady state.")] = 8,
    realisations: Annotated[int, typer.Option("--realisations", help="Repeated with other phases.")] = 2,
    grid: Annotated[str, typer.Option("--grid", help="full, odd, odd_odd or random_odd.")] = "random_odd",
    offset_velocity: Annotated[
        float | None,
        typer.Option("--offset-velocity", help="m/s under the excitation; found if left out.", show_default=False),
    ] = None,
    travel: Annotated[float | None, typer.Option("--travel", help="Limit, m.", show_default=False)] = None,
    speed: Annotated[float | None, typer.Option("--speed", help="Limit, m/s.", show_default=False)] = None,
    force: Annotated[float | None, typer.Option("--force", help="Limit, N.", show_default=False)] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of grid, phases and noise.")] = 0,
    out: Out = None,
) -> None:
    """Design a multisine, check travel, speed and force by simulation, and write it to be sent to the drive."""
    from feeddrive.cli.excite import perform

    asked = {
        "amplitude": amplitude, "where": where, "resolution": resolution, "periods": periods, "grid": grid,
        "realisations": realisations, "offset_velocity": offset_velocity, "travel": travel, "speed": speed,
        "force": force, "seed": seed,
    }  # fmt: skip
    perform(machine, axis, band, out, asked)


app.command()(identify_command.identify)
app.command()(identify_command.channels)
app.command()(friction)
app.command()(cogging)
app.command()(tune)
app.command()(certify)
app.command()(check)
app.command()(export)
app.command()(verify)
app.command()(play)
app.command()(listen)
app.command("virtual-drive")(virtual_drive)
app.command()(cosimulate)
