"""`feeddrive excite`: an excitation signal for measuring the frequency response of an axis.

The files hold the signal to play, the simulated response, and the limits that were checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.run_files import write_run_csv, write_run_parquet
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.excitation import Excitation, design_excitation, readable
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.text import Text
from feeddrive.language.units import turning
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import UNITS
from feeddrive.plot.over_frequency import frequency_estimate_chart
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, frequencies, line, option, stem

_USELESS = 0.3  # relative standard deviation beyond which a line is useless for tuning
WARNING = (
    "The axis moves by itself while this is sent. Keep the travel clear, keep a hand on the stop, and begin with a "
    "tenth of the amplitude."
)


class ExciteRequest(Request):
    """The axis; injection point, band and amplitude of the excitation; and the limits to check."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    band: str = option("band in Hz, as 5..500")
    amplitude: float = option("peak: N on the force, m on the setpoint; N m and rad of an axis that turns")
    axis: str | None = option("the axis, if the machine has several", default=None)
    where: str = option("signal that is excited: force or setpoint", default="force")
    resolution: float = option("distance from line to line", default=1.0, unit="Hz")
    periods: int = option("periods in steady state", default=8, least=2)
    # the default of two: a second draw of the phases separates nonlinear distortion from noise
    realisations: int = option("number of repetitions with other phases", default=2, least=1)
    # the default shows even and odd distortion on the lines left empty, with most lines excited
    grid: str = option("excited lines: full, odd, odd_odd or random_odd", default="random_odd")
    offset_velocity: float | None = option("velocity under the excitation; found if left out", unit="m/s", default=None)
    travel: float | None = option("limit of the travel", unit="m", default=None)
    speed: float | None = option("limit of the speed", unit="m/s", default=None)
    force: float | None = option("limit of the force", unit="N", default=None)
    seed: int = option("seed of grid, phases and noise", default=0)
    out: Path | None = option(OUT, short="-o", default=None)

    @property
    def name(self) -> str:
        """The name of the excitation and its directory: that of the machine file, with the axis if one was given."""
        return f"{stem(self.machine)}{'' if self.axis is None else f'_{self.axis}'}"

    def usual_out(self) -> Path:
        return Path("results") / f"excite_{self.name}"


@command(ExciteRequest)
def excite(request: ExciteRequest, progress: Progress) -> Outcome[Excitation]:
    """Design a multisine, check travel, velocity and force by simulation, and write the files if `out` is set.

    Raises ParameterError for a band, a grid or a limit that cannot be satisfied.
    """
    machine = read_machine(request.machine)
    loop = machine.loop(request.axis)
    progress.step("designing and simulating")
    excitation = design_excitation(
        loop,
        band=frequencies(request.band),
        name=request.name,
        amplitude=request.amplitude,
        where=request.where,
        resolution=request.resolution,
        periods=request.periods,
        grid=request.grid,
        realisations=request.realisations,
        offset_velocity=request.offset_velocity,
        travel=request.travel,
        speed=request.speed,
        force=request.force,
        seed=request.seed,
    )
    files: dict[str, str] = {}
    then, notes = "", list[str]()
    page = partial(
        excitation_report,
        excitation,
        {"Machine": machine.name, "Source of its numbers": machine.source or "not stated"},
    )
    if request.out is not None:
        progress.step("report")
        report = write_excitation(excitation, request.out, page())
        files["Report"] = f"{report}, to be sent: {report.parent / 'excitation_1.csv'}"
        logs = [report.parent / f"simulated_{k}.parquet" for k, _ in enumerate(excitation.drawings, start=1)]
        then = line("frf", *logs)
        notes.append("Once the machine has played the excitation, its own logs take the place of the simulated ones.")
    return Outcome(
        excitation,
        [excitation.table()],
        [*excitation.remarks, WARNING],
        notes=notes,
        files=files,
        page=page,
        then=then,
    )


def write_excitation(excitation: Excitation, out: str | Path, page: Report) -> Path:
    """Write the files `excitation_K.csv` and `simulated_K.parquet`, K = 1, 2, ..., and `report.html`; return its path.

    An excitation file holds time, excitation and the set position of the underlying motion.  A simulated log holds all
    channels that `feeddrive frf` needs.  Raises FileError if the directory cannot be written.
    """
    of_axis = turning if excitation.rotary else str
    with new_directory(out) as folder:
        for i, drawn in enumerate(excitation.drawings, start=1):
            sent = {"excitation": drawn.excitation, "set_position": drawn.set_position}
            units = {"excitation": excitation.unit, "set_position": of_axis("m")}
            # a readable file: 0.00015, not 0.00015000000000000001
            stamps = np.round(drawn.time, 12)
            write_run_csv(folder / f"excitation_{i}.csv", stamps, sent, units)
            columns = {"excitation": drawn.excitation, **drawn.signals}
            units = {name: of_axis(UNITS.get(name, "m")) for name in columns} | {"excitation": excitation.unit}
            write_run_parquet(folder / f"simulated_{i}.parquet", drawn.time, columns, units, excitation.sample_time)
        (folder / "report.html").write_text(html(page), encoding="utf-8")
    return Path(out) / "report.html"


def rehearsed(excitation: Excitation, output: str = "reading_load") -> tuple[FrequencyEstimate, FRF]:
    """Return the frequency response estimated from the simulated measurement, and that of the linearized model."""
    estimate = estimate_frf(excitation.records(output), method="periodic", period=excitation.period)
    # friction is linearized at a velocity, since dry friction has no slope at standstill
    velocity = excitation.offset_velocity or 0.05
    # from the cut, where the loop is open: the response of the axis alone, whatever the control does
    model = linearize(excitation.loop, ["cut"], [output], velocity=velocity)
    return estimate, model.response(np.geomspace(estimate.frequency[0], estimate.frequency[-1], 1000))


def _lost(frequency: np.ndarray, share: np.ndarray) -> str:
    """Return a sentence about frequency lines with too much noise, and the remedy; empty if there are no such lines."""
    good = np.flatnonzero(share < _USELESS)
    lost = share.size - good.size
    if lost == 0:
        return ""
    ends = good.size and good[-1] < share.size - 1
    above = Text(f", all above {Quantity(frequency[good[-1]], 'Hz')} among them") if ends else ""
    remedy = f"take more amplitude or more periods{', or end the band there' if ends else ''}"
    return Text(f" {lost} of {share.size} lines are not known to {Quantity(_USELESS, 'share')}{above}: {remedy}.")


def excitation_report(excitation: Excitation, known: Mapping[str, str] | None = None) -> Report:
    """Return the report of an excitation and its expected measurement; `known` holds facts about the machine."""
    estimate, model = rehearsed(excitation)
    assert estimate.frf.variance is not None
    share = np.sqrt(estimate.frf.variance) / estimate.frf.magnitude
    lead = [
        Text(
            f"{excitation.lines.size} lines from {span(excitation.frequency[0], excitation.frequency[-1], 'Hz')} on "
            f"the {excitation.where}, peak {readable(excitation.amplitude, excitation.unit)}, crest factor "
            f"{number(excitation.crest, 4)}; all limits that were stated hold in the simulation."
        ),
        Text(
            f"Expect a deviation of {Quantity(np.median(share), 'share'):2} in the middle and "
            f"{Quantity(np.max(share), 'share'):3} at worst, at "
            f"{Quantity(estimate.frequency[int(np.argmax(share))], 'Hz')}, if noise and friction of the machine are "
            f"those of its file.{_lost(estimate.frequency, share)}"
        ),
        WARNING,
    ]
    first, expected = (
        Picture(
            "excitation",
            "What is sent, and what the axis does",
            "First realisation. Between the dashed lines the speed must keep its sign.",
            "Excitation, speed and force over time.",
            excitation.chart,
        ),
        Picture(
            "expected",
            "What the measurement will show",
            "The response estimated from the simulated log, and the response of the model.",
            "Estimated and modelled response over frequency.",
            lambda: frequency_estimate_chart(estimate, model),
        ),
    )
    stated = {
        **(known or {}),
        "Grid": Text(
            f"{excitation.grid}, lines at multiples of "
            f"{Quantity(1.0 / (excitation.period * excitation.sample_time), 'Hz')}"
        ),
        "Periods": f"{excitation.periods} of {excitation.period} samples, each realisation swells and fades over "
        f"{excitation.fade}",
        "Motion underneath": Text(f"{readable(excitation.offset_velocity, 'm/s')}, back in every second realisation"),
        "Least speed while excited": Text(f"{readable(excitation.least_velocity, 'm/s')}"),
    }
    noted = Remarks([*excitation.remarks, *estimate.remarks])
    return Report(
        "Excitation for a frequency response",
        "feeddrive excite",
        Verdict(lead),
        (
            Section("limits", "Limits", (excitation.table(), noted)),
            further((expected,)),
            facts("What was designed", stated),
        ),
        first,
        excitation.rotary,
    )
