"""The options of `feeddrive certify` and `feeddrive check`, thin skins like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def certify(
    source: Annotated[str, typer.Argument(help="A machine file (TOML), or the name of a bundled machine.")],
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at", help="Another plant: a machine, or a measured response in m/N. Repeat.", show_default=False
        ),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option("--measured", help="Response of this axis: its lines give the discs.", show_default=False),
    ] = None,
    motor: Annotated[
        Path | None, typer.Option("--motor", help="The same of the motor's encoder.", show_default=False)
    ] = None,
    fit: Annotated[
        bool, typer.Option("--fit", help="Fit the plant to --measured instead of taking the machine's.")
    ] = False,
    radius: Annotated[
        float | None,
        typer.Option(
            "--radius", help="|dP/P|: of models, 0.2; the least of measured plants, 0.05.", show_default=False
        ),
    ] = None,
    beyond: Annotated[float, typer.Option("--beyond", help="Least |dP/P| above the last measured line.")] = 1.0,
    arithmetic: Annotated[
        str, typer.Option("--arithmetic", help="Of the coefficients: float64, float32, fixed24 ...")
    ] = "float64",
    float32: Annotated[bool, typer.Option("--float32", help="The same as --arithmetic float32.")] = False,
    confidence: Annotated[float, typer.Option("--confidence", help="That all measured lines lie in the discs.")] = 0.95,
    velocity: Annotated[float, typer.Option("--velocity", help="m/s at which the axis moves.")] = 0.05,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Directory; one that feeddrive wrote before is replaced.", show_default=False),
    ] = None,
) -> None:
    """Prove a loop, as it will run, stable for plants with a disc around each; write a certificate and a report."""
    from feeddrive.cli.certify import Asked, perform

    perform(
        Asked(
            source=source, axis=axis, others=at or (), measured=measured, motor=motor, fit=fit, radius=radius,
            beyond=beyond, arithmetic="float32" if float32 else arithmetic, confidence=confidence, velocity=velocity,
            out=out,
        )
    )  # fmt: skip


def check(file: Annotated[Path, typer.Argument(help="A certificate (JSON).")]) -> None:
    """Check a certificate in exact arithmetic: 0 if it is proven, 1 with the reason if it is refused."""
    from feeddrive.certificate.check import main

    raise SystemExit(main([str(file)]))
