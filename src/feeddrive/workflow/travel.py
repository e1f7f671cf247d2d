"""`feeddrive travel`: tune a law over the travel of an axis, as a schedule of its parameters over the position."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from feeddrive.figures.catalogue import goals, limitable
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Table
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.travel import Travel, TunedTravel, tune_travel
from feeddrive.workflow.command import Outcome, Request, argument, command, exporting, frequencies, option
from feeddrive.workflow.tune import limit_options
from feeddrive.workflow.tune_files import machine_text


class TravelRequest(Request, more=limit_options(), after="law"):
    """The machine files of one axis at its positions, the goal of the tuning, and the limits to keep everywhere.

    Positions are in m here, in mm on the command line; limits as for `tune`.
    """

    machines: tuple[MachineLike, ...] = argument("Machine files of one axis (TOML), one for each position")
    position: tuple[float, ...] = option(
        "position of each machine file, in their order; repeated", unit="m", entered="mm", default=()
    )
    goal: str = option("goal of the tuning", default="rope-snap", options=tuple(goals()))
    law: str | None = option("another law, as pole_placement; default: that of the first file", default=None)
    reading_noise: float = option("noise of the readings, RMS, white", default=0.0, unit="m", entered="nm", least=0.0)
    band: str | None = option("band of the stiffness, as 1..30 in Hz", default=None)
    between: int = option("positions between two places at which the limits are judged", default=4, least=0, most=100)
    axis: str | None = option("its axis, if it has several", default=None)
    starts: int = option("searches", default=2, least=1, most=100)
    seed: int = option("seed of the searches after the first", default=0)
    out: Path | None = option(
        "machine file to write, the first one with the schedule as its law", short="-o", default=None
    )

    def check(self) -> None:
        """Raise ParameterError unless every machine file has its position."""
        if len(self.machines) != len(self.position):
            raise ParameterError(
                f"--position is given {len(self.position)} times for {len(self.machines)} machine files: give the "
                f"position of each file, in the order of the files"
            )
        twice = next((x for i, x in enumerate(self.position) if x in self.position[:i]), None)
        if twice is not None:
            raise ParameterError(f"--position {Quantity(twice, 'm'):6 SI} is given twice: one file for each position")

    def limits(self) -> Limits:
        """Return the limits of the tuned loop."""
        bounds = {f.key: getattr(self, f.limit.option) for f in limitable() if f.limit is not None}
        return Limits((), reading_noise=(self.reading_noise, self.reading_noise), **bounds)


@command(TravelRequest)
def travel(request: TravelRequest, progress: Progress) -> Outcome[TunedTravel]:
    """Tune a law over the travel of an axis: its parameters at each position, interpolated between them.

    The result is a `TunedTravel`. If a limit is exceeded between the positions, no machine file is written and the
    judgment of the outcome is negative.
    Raises ParameterError for fewer than three positions, and the errors of `tuning.tune_travel`.
    """
    progress.step("reading")
    machines = [read_machine(machine) for machine in request.machines]
    loops = {x: machine.loop(request.axis) for x, machine in zip(request.position, machines, strict=True)}
    along = Travel.of(loops)
    base, name = machines[0], machines[0].named(request.axis)
    today = base.loops[name]
    control = today.control
    if request.law is not None and request.law != control.law.kind:
        control = control_with(today, request.law)
    found = tune_travel(
        along,
        control,
        goal=request.goal,
        limits=request.limits(),
        band=(0.0, math.inf) if request.band is None else frequencies(request.band),
        starts=request.starts,
        seed=request.seed,
        between=request.between,
        progress=progress,
    )
    files: dict[str, Path] = {}
    if request.out is not None and found.holds:
        text = with_origins(machine_text(base, name, found.control), tuple(request.machines))
        write_whole(request.out, text)
        files["Machine"] = request.out
    judgment = Judgment.TAKE_SCHEDULE if found.holds else Judgment.DO_NOT_USE_SCHEDULE
    then, notes = exporting(files["Machine"], request.axis, guarded=control.guard is not None) if files else ("", ())
    return Outcome(
        found,
        [found.table(), _values(found), along.table()],
        [],
        found.sentence,
        notes,
        files=files,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        rotary=today.axis.rotary,
        then=then,
    )


def _values(found: TunedTravel) -> Table:
    """Tabulate the tuned parameters: the best fixed ones, and those of each place."""
    rows: list[Any] = []
    for name, value in found.fixed.tunables.items():
        unit = tree.declaration(found.fixed.control, name).unit
        values = [value, *(tree.get(tuned.control, name) for tuned in found.places)]
        rows.append([name, *(Quantity(float(number), unit, form="5 SI") for number in values), UNIT])
    places = [row.position for row in found.after if row.position in _positions(found)]
    heads = [Quantity(position, "m", form="4 SI") for position in places]
    return Table("the parameters", ["parameter", "fixed", *(f"at {head}" for head in heads), "unit"], rows)


def _positions(found: TunedTravel) -> set[float]:
    return {float(position) for position in found.control.law.scheduled_at()}
