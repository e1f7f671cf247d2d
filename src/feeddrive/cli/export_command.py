"""The options of `feeddrive export` and `feeddrive verify`, thin skins like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.out import Out


def export(
    source: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    target: Annotated[
        str,
        typer.Option(
            "--target",
            "-t",
            help="c, linuxcnc, linuxcnc-pid, fmu2, fmu3, cortex-m, st, or parameters.",
            show_default=False,
        ),
    ],
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    out: Out = None,
    name: Annotated[
        str | None, typer.Option("--name", help="Prefix of all names; default: axis_x.", show_default=False)
    ] = None,
    precision: Annotated[
        str | None,
        typer.Option(
            "--precision", help="double or float; default: double, cortex-m float.", show_default=False
        ),
    ] = None,
    plant: Annotated[
        bool, typer.Option("--plant", help="c, fmu2, fmu3: the axis, to stand in for the machine.")
    ] = False,
    header_only: Annotated[bool, typer.Option("--header-only", help="c: a single header.")] = False,
    joint: Annotated[
        int | None, typer.Option("--joint", help="linuxcnc, linuxcnc-pid: number of the joint.", show_default=False)
    ] = None,
    route: Annotated[
        str | None, typer.Option("--route", help="linuxcnc-pid: one or two pids.", show_default=False)
    ] = None,
    units: Annotated[
        float | None,
        typer.Option("--units", help="linuxcnc-pid: machine units in a meter, 1000 for mm.", show_default=False),
    ] = None,
    core: Annotated[
        str | None, typer.Option("--core", help="cortex-m: m4f, m7, or m7dp.", show_default=False)
    ] = None,
    maker: Annotated[
        list[str] | None,
        typer.Option(
            "--maker", help="parameters: sinumerik, twincat, odrive, linuxcnc or csv; may be repeated. Default: all.",
            show_default=False,
        ),
    ] = None,
    lead: Annotated[
        float | None,
        typer.Option("--lead", help="parameters: lead of the screw in m, if the file has none.", show_default=False),
    ] = None,
    gear: Annotated[
        float | None,
        typer.Option("--gear", help="parameters: turns of the motor in one of the screw.", show_default=False),
    ] = None,
) -> None:  # fmt: skip
    """Write the control of an axis for a target: what is written computes what was simulated, bit for bit."""
    from feeddrive.cli.export import perform

    perform(
        source, target, out, axis=axis, name=name, precision=precision, plant=plant, single_header=header_only,
        joint=joint, route=route, units=units, core=core, makers=tuple(maker or ()), lead=lead, gear=gear,
    )  # fmt: skip


def verify(
    directory: Annotated[Path, typer.Argument(help="A directory that `feeddrive export` wrote.")],
    samples: Annotated[
        int | None,
        typer.Option("--samples", help="Of the trial; default: 1000000, 5000 in single precision.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the random samples.")] = 1,
    compiler: Annotated[
        str | None, typer.Option("--compiler", help="Another compiler than gcc, cc or clang.", show_default=False)
    ] = None,
    flag: Annotated[
        list[str] | None,
        typer.Option("--flag", help="A flag for it, such as -O3; may be repeated.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File for the certificate (text).", show_default=False)
    ] = None,
) -> None:
    """Run the equality proof of an export again, with this machine's compiler; 1 if anything differs."""
    from feeddrive.cli.verify import perform

    perform(directory, samples, seed, compiler, tuple(flag or ()), out)
