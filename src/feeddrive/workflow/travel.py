"""`feeddrive travel`: tune a law over the travel of an axis, as a schedule of its parameters over the position.

With `--payload` the schedule is over the payload, too.  With `--certify` the control is proven at every position
between the measured ones, and up to a speed.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive import plot
from feeddrive.blocks.controller.gain_schedule import GainSchedule
from feeddrive.certificate.travel_proof import OUTSIDE, TravelProof, document, prove_along_travel
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.origins import origins, with_origins
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Table
from feeddrive.language.text import Text, capitalized, joined
from feeddrive.loop.control import Control
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.travel import Pair, Travel, TunedTravel, tune_travel
from feeddrive.workflow.command import Outcome, Request, argument, command, exporting, frequencies, option
from feeddrive.workflow.tune import limit_options
from feeddrive.workflow.tune_files import machine_text

_ROOM = 1.01  # of the limit of Ms: what is tuned to it may exceed it between places by what the tuning tolerates
_JUDGMENTS = {
    True: Judgment.TRAVEL_PROVEN,
    False: Judgment.TRAVEL_NOT_PROVEN,
    None: Judgment.TRAVEL_UNDECIDED,
}


class TravelRequest(Request, more=limit_options(), after="law"):
    """The machine files of one axis at its positions, the goal of the tuning, and the limits to keep everywhere.

    Positions are in m here, in mm on the command line; limits as for `tune`.  With payloads there is a file for each
    pair of position and payload.
    """

    machines: tuple[MachineLike, ...] = argument("Machine files of one axis (TOML), one for each position")
    position: tuple[float, ...] = option(
        "position of each machine file, in their order; repeated", unit="m", entered="mm", default=()
    )
    payload: tuple[float, ...] = option(
        "mass on the table of each machine file, in their order; repeated; none if it never changes",
        unit="kg",
        default=(),
        least=0.0,
    )
    robust: bool = option(
        "with --payload: gains by the position alone, that keep the limits with every payload; default: by both",
        default=False,
    )
    goal: str = option("goal of the tuning", default="rope-snap", options=tuple(goals()))
    law: str | None = option("another law, as pole_placement; default: that of the first file", default=None)
    reading_noise: float = option("noise of the readings, RMS, white", default=0.0, unit="m", entered="nm", least=0.0)
    band: str | None = option("band of the stiffness, as 1..30 in Hz", default=None)
    between: int = option("positions between two places at which the limits are judged", default=4, least=0, most=100)
    axis: str | None = option("its axis, if it has several", default=None)
    starts: int = option("searches", default=2, least=1, most=100)
    seed: int = option("seed of the searches after the first", default=0)
    kept: bool = option("prove the control of the first file as it is, and tune nothing; with --certify", default=False)
    certify: Path | None = option(
        "prove every position between the measured ones, and the speed; write the proof for `feeddrive check`",
        default=None,
    )
    prove_ms: float | None = option(
        "with --certify: the Ms that no position may exceed; default: the limit of Ms and 1 %", above=1.0, default=None
    )
    prove_payload: float | None = option(
        "with --certify and --payload: the payload that is proven; one a proof", unit="kg", default=None, least=0.0
    )
    frozen: bool = option("with --certify: prove the axis that stays where it is, and no speed", default=False)
    report: Path | None = option("page to write (HTML): goal, stiffness and Ms over the position", default=None)
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
        if len(self.payload) not in (0, len(self.machines)):
            raise ParameterError(
                f"--payload is given {len(self.payload)} times for {len(self.machines)} machine files: give the "
                f"payload of each file, in the order of the files, or none"
            )
        pairs = self.pairs()
        twice = next((pair for i, pair in enumerate(pairs) if pair in pairs[:i]), None)
        if twice is not None:
            with_ = "" if twice.payload is None else f" with --payload {Quantity(twice.payload, 'kg'):6 SI}"
            raise ParameterError(
                f"--position {Quantity(twice.position, 'm'):6 SI}{with_} is given twice: one file for each "
                f"{'position' if twice.payload is None else 'pair'}"
            )
        if self.robust and not self.payload:
            raise ParameterError("--robust is about payloads: give the payload of each machine file by --payload")
        if self.prove_payload is not None and not self.payload:
            raise ParameterError(
                "--prove-payload is about payloads: give the payload of each machine file by --payload"
            )
        if self.certify is not None and self.payload and self.prove_payload is None:
            raise ParameterError("a proof along the travel is that of one payload: name it by --prove-payload")
        for name in ("kept", "prove_ms", "frozen", "prove_payload"):
            value = getattr(self, name)
            if value is not None and value is not False and self.certify is None:
                raise ParameterError(
                    f"--{name.replace('_', '-')} is about a proof: name its file by --certify proof.json"
                )
        for name in ("out", "law"):
            if self.kept and getattr(self, name) is not None:
                raise ParameterError(f"--kept proves the control as it is: leave out --{name}")

    def pairs(self) -> list[Pair]:
        """Return position and payload of each machine file."""
        if not self.payload:
            return [Pair(x) for x in self.position]
        return [Pair(x, load) for x, load in zip(self.position, self.payload, strict=True)]

    def limits(self) -> Limits:
        """Return the limits of the tuned loop."""
        bounds = {f.key: getattr(self, f.limit.option) for f in limitable() if f.limit is not None}
        return Limits((), reading_noise=(self.reading_noise, self.reading_noise), **bounds)


@command(TravelRequest)
def travel(request: TravelRequest, progress: Progress) -> Outcome[Any]:
    """Tune a law over the travel of an axis: its parameters at each position, interpolated between them.

    The result is a `TunedTravel`, or with `kept` a `TravelProof`. If a limit is exceeded between the positions, or the
    proof fails, no machine file and no proof are written and the judgment of the outcome is negative.
    Raises ParameterError for fewer than three positions, and the errors of `tuning.tune_travel` and
    `certificate.prove_along_travel`.
    """
    progress.step("reading")
    machines = [read_machine(machine) for machine in request.machines]
    loops = dict(zip(request.pairs(), [machine.loop(request.axis) for machine in machines], strict=True))
    along = Travel.of(loops)
    base, name = machines[0], machines[0].named(request.axis)
    today = base.loops[name]
    if request.kept:
        return _proven(request, along, today.control, None, progress)
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
        robust=request.robust,
        progress=progress,
    )
    outcome = _proven(request, along, found.control, found, progress)
    if request.out is None or outcome.judgment.bad:
        return outcome
    tuned = found.control
    if request.payload and isinstance(tuned.law, GainSchedule):
        # the file is the first one: so is its payload
        tuned = replace(tuned, law=tuned.law.with_payload(request.payload[0]))
    text = with_origins(machine_text(base, name, tuned), tuple(request.machines))
    write_whole(request.out, text)
    then, notes = exporting(request.out, request.axis, guarded=control.guard is not None)
    return replace(outcome, files={"Machine": request.out, **outcome.files}, then=then, notes=notes)


def _proven(
    request: TravelRequest, along: Travel, control: Control, found: TunedTravel | None, progress: Progress
) -> Outcome[Any]:
    """Return the outcome of a tuning, of a proof, or of both; write the proof and the page."""
    holds = found is None or found.holds
    proof: TravelProof | None = None
    if request.certify is not None and holds:
        limit = request.limits().limit(SENSITIVITY_PEAK)
        bound = request.prove_ms or (None if limit is None else _ROOM * limit.bound)
        one = along if request.prove_payload is None else along.with_payload(request.prove_payload)
        proof = prove_along_travel(one, control, sensitivity_peak=bound, speed=not request.frozen, progress=progress)
    judgment = Judgment.TAKE_SCHEDULE if holds else Judgment.DO_NOT_USE_SCHEDULE
    sentences = [] if found is None else [found.sentence]
    if proof is not None:
        judgment = _JUDGMENTS[proof.proven]
        moving = Text(f" {capitalized(proof.moving)}.") if proof.moving and proof.proven else ""
        said = Text(f"Proven: {proof.claim}.{moving}") if proof.proven else Text(f"{judgment.says}: {proof.reason}.")
        sentences.append(said)
    tables = [] if found is None else [found.table(), _values(found)]
    page = partial(travel_report, found, proof, along)
    outcome = Outcome[Any](
        proof if found is None else found,
        [*tables, along.table(), *([] if proof is None else [proof.table()])],
        [] if proof is None else [Text(f"Not covered: {'; '.join(OUTSIDE)}.")],
        Text(". ".join(sentences)) if len(sentences) == 1 else joined(". ", [Text(text) for text in sentences]),
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        rotary=along.loop.axis.rotary,
        page=page,
    )
    files: dict[str, Path] = {}
    if proof is not None and proof.proven:
        assert request.certify is not None
        made_from = [{"file": o.file, "sha256": o.sha256} for o in origins(request.machines)]
        write_whole(request.certify, json.dumps(document(proof, made_from)) + "\n")
        files["Proof"] = request.certify
    if request.report is not None:
        write_whole(request.report, html(page()))
        files["Report"] = request.report
    return replace(outcome, files=files)


def tuned_travel_report(found: TunedTravel) -> Report:
    """Return the report of a tuning over the travel."""
    return travel_report(found, None, found.travel)


def proof_report(proof: TravelProof) -> Report:
    """Return the report of a proof along the travel."""
    return travel_report(None, proof, proof.along.travel)


def travel_report(found: TunedTravel | None, proof: TravelProof | None, along: Travel) -> Report:
    """Return the report of a tuning over the travel, of a proof along it, or of both."""
    sentences: list[str] = [] if found is None else [capitalized(Text(f"{found.sentence}."))]
    sentences += [] if proof is None else [capitalized(Text(f"{proof.sentence()}."))]
    good = (found is None or found.holds) and (proof is None or proof.proven is True)
    tables = [*([] if found is None else [found.table(), _values(found)]), *([] if proof is None else [proof.table()])]
    picture = None
    if found is not None:
        worst = "" if found.travel.payloads is None else ", with the worst payload"
        picture = Picture(
            "travel",
            "Along the travel",
            f"Fixed gains and the schedule, each frozen at its position{worst}; shaded: proven.",
            "Goal, least stiffness and Ms over the position, of fixed gains and of the schedule.",
            lambda: plot.travel_chart(found, proof),
        )
    outside = () if proof is None else (Section("outside", "What is outside", (Remarks(OUTSIDE, "", warns=False),)),)
    return Report(
        "Gains over the travel",
        "feeddrive travel",
        Verdict(tuple(sentences), good=good),
        (Section("result", "Result", tuple(tables)), Section("axis", "The axis", (along.table(),)), *outside),
        picture,
        along.loop.axis.rotary,
    )


def _values(found: TunedTravel) -> Table:
    """Tabulate the tuned parameters: the best fixed ones, and those of each place."""
    rows: list[Any] = []
    for name, value in found.fixed.tunables.items():
        unit = tree.declaration(found.fixed.control, name).unit
        values = [value, *(tree.get(tuned.control, name) for tuned in found.places)]
        rows.append([name, *(Quantity(float(number), unit, form="5 SI") for number in values), UNIT])
    law = found.control.law
    assert isinstance(law, GainSchedule)
    heads = [
        Pair(float(place.position), float(load.payload) if load is not None else None)
        for place in law.places
        for load in place.loads or (None,)
    ]
    return Table("the parameters", ["parameter", "fixed", *(f"at {pair.text}" for pair in heads), "unit"], rows)
