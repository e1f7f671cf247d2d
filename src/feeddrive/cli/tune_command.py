"""The options of `feeddrive tune`, a thin door like those of commands.py."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from feeddrive.cli.out import Out


def tune(
    source: Annotated[
        str, typer.Argument(help="A machine file (TOML), the name of a bundled machine, or a measured response in m/N.")
    ],
    goal: Annotated[
        str, typer.Option("--goal", help="rope-snap, stiffness, least-stiffness or bandwidth.")
    ] = "rope-snap",
    law: Annotated[
        str | None, typer.Option("--law", help="Another law, as pole_placement.", show_default=False)
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            "--recipe",
            help="No search but a rule: symmetric-optimum, kv-rule, half-antiresonance, margins-robust or "
            "margins-dynamic.",
            show_default=False,
        ),
    ] = None,
    max_ms: Annotated[float, typer.Option("--max-ms", help="Largest sensitivity peak Ms.")] = 2.0,
    gain_margin: Annotated[
        float | None, typer.Option("--gain-margin", help="Least gain margin in dB.", show_default=False)
    ] = None,
    phase_margin: Annotated[
        float | None, typer.Option("--phase-margin", help="Least phase margin in deg.", show_default=False)
    ] = None,
    delay_margin: Annotated[
        float | None, typer.Option("--delay-margin", help="Least delay margin in samples.", show_default=False)
    ] = None,
    max_compliance: Annotated[
        float | None, typer.Option("--max-compliance", help="Largest compliance in um/N.", show_default=False)
    ] = None,
    max_noise: Annotated[
        float | None, typer.Option("--max-noise", help="Largest noise in the force, N RMS.", show_default=False)
    ] = None,
    reading_noise: Annotated[
        float, typer.Option("--reading-noise", help="Noise of the readings in nm RMS, white.")
    ] = 0.0,
    step_force: Annotated[
        float | None,
        typer.Option(
            "--step-force",
            help="N on the table: a step of it may not drive the command to the force limit of the control.",
            show_default=False,
        ),
    ] = None,
    band: Annotated[
        str | None, typer.Option("--band", help="Of the stiffness, as 1..30 in Hz.", show_default=False)
    ] = None,
    filters: Annotated[
        str, typer.Option("--filters", help="kept, free, or placed: free, and notches where they pay.")
    ] = "placed",
    baseline: Annotated[
        str | None,
        typer.Option("--baseline", help="Today's machine file, to compare with and to write into.", show_default=False),
    ] = None,
    axis: Annotated[str | None, typer.Option("--axis", help="Its axis, if it has several.", show_default=False)] = None,
    at: Annotated[
        list[str] | None,
        typer.Option("--at", help="The same axis at another position or load; may be repeated.", show_default=False),
    ] = None,
    motor: Annotated[
        list[str] | None,
        typer.Option(
            "--motor",
            help="Response of the motor's encoder: a file, or its name in the files; once, or once for each place; "
            "none if there is one encoder.",
            show_default=False,
        ),
    ] = None,
    disturbance: Annotated[
        Path | None, typer.Option("--disturbance", help="Response to a force on the table.", show_default=False)
    ] = None,
    disturbance_motor: Annotated[
        Path | None,
        typer.Option("--disturbance-motor", help="The same of the motor's encoder.", show_default=False),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option("--unit", help="Of the responses, as um/N, if the files do not say it.", show_default=False),
    ] = None,
    sample_time: Annotated[
        float | None, typer.Option("--sample-time", help="s, of the control.", show_default=False)
    ] = None,
    delay: Annotated[
        float,
        typer.Option(
            "--delay", help="s of dead time that the response does not hold: 0 if it leads from the commanded force."
        ),
    ] = 0.0,
    confidence: Annotated[float, typer.Option("--confidence", help="That all limits hold on the true axis.")] = 0.95,
    starts: Annotated[int, typer.Option("--starts", min=1, max=20, help="Searches; the best end counts.")] = 2,
    seed: Annotated[int, typer.Option("--seed", help="Of the searches after the first.")] = 0,
    out: Out = None,
) -> None:
    """Tune gains and filters of an axis within limits; write a machine file and a report before against after."""
    from feeddrive.cli.tune import Asked, perform
    from feeddrive.language.errors import ParameterError
    from feeddrive.tuning.shaping.limits import Limits

    try:
        limits = Limits(
            sensitivity_peak=max_ms, gain_margin_dB=gain_margin, phase_margin_deg=phase_margin,
            delay_margin_samples=delay_margin,
            compliance_peak=None if max_compliance is None else 1e-6 * max_compliance,
            force_noise=max_noise, reading_noise=(1e-9 * reading_noise, 1e-9 * reading_noise), snap_force=step_force,
        )  # fmt: skip
    except ParameterError as error:
        raise ParameterError(_by_option(str(error))) from None
    perform(
        Asked(
            source=source, others=at or (), motor=motor or (), disturbance=disturbance,
            disturbance_motor=disturbance_motor, unit=unit, sample_time=sample_time, delay=delay, baseline=baseline,
            axis=axis, law=law, recipe=recipe, goal=goal, band=band, filters=filters, confidence=confidence,
            limits=limits, starts=starts, seed=seed, out=out,
        )
    )  # fmt: skip


def _by_option(text: str) -> str:
    """A sentence on a limit with the name of its option."""
    for field, option in (
        ("sensitivity_peak", "--max-ms, sensitivity_peak"),
        ("gain_margin_dB", "--gain-margin, gain_margin_dB"),
        ("phase_margin_deg", "--phase-margin, phase_margin_deg"),
        ("delay_margin_samples", "--delay-margin, delay_margin_samples"),
        ("compliance_peak", "--max-compliance, compliance_peak in m/N"),
        ("force_noise needs reading_noise", "--max-noise needs --reading-noise (in nm)"),
        ("force_noise", "--max-noise, force_noise"),
        ("snap_force", "--step-force, snap_force"),
    ):
        if text.startswith(field):
            return text.replace(field, option, 1)
    return text
