"""`feeddrive certify`: a stability certificate for a machine and its measured responses.

A certificate is written, together with a report, only after the checker has accepted it, and read only if the checker
accepts it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from feeddrive import plot
from feeddrive.certificate import check
from feeddrive.certificate.box_proof import OUTSIDE, document, prove_over_box
from feeddrive.certificate.certificate import Certificate
from feeddrive.certificate.certify import PlantLike, certify_loop, point_plants
from feeddrive.files.atomic_io import new_directory, read_whole, write_whole
from feeddrive.files.frf import FrfLike, encoders, read_frf, read_frfs
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import digest_of, origins
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError, sentence
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Column, Table
from feeddrive.language.text import Text, capitalized
from feeddrive.language.units import turning
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.tuning.operating_point import OperatingPoint
from feeddrive.workflow.command import OUT, Outcome, Request, argument, called, command, exporting, option, stem
from feeddrive.workflow.tune_sources import in_metres, loop_or_response

FILE = "certificate.json"
BOX_FILE = "box_proof.json"
_BOX = {True: Judgment.BOX_PROVEN, False: Judgment.BOX_NOT_PROVEN, None: Judgment.BOX_UNDECIDED}


class CertifyRequest(Request):
    """The loop to certify, its plants with their uncertainty discs, and the arithmetic of the controller."""

    source: MachineLike | Loop = argument("A machine file (TOML), or the name of a bundled machine")
    axis: str | None = option("its axis, if it has several", default=None)
    at: tuple[MachineLike | Loop | FRF, ...] = option(
        "another plant: a machine, or a measured response in m/N (of an axis that turns in rad/(N m)); repeat",
        default=(),
    )
    measured: Path | FRF | None = option("response of this axis: its lines give the discs", default=None)
    motor: Path | FRF | None = option("response at the motor's encoder", default=None)
    fit: bool = option("fit the plant to --measured instead of taking the machine's", default=False)
    radius: float | None = option(
        "|dP/P|: uncertainty of models, default 0.2; least uncertainty of measured plants, default 0.05", default=None
    )
    beyond: float = option("least |dP/P| above the last measured line", default=1.0)
    arithmetic: str = option("arithmetic of the coefficients: float64, float32, fixed24 ...", default="float64")
    float32: bool = option("the same as --arithmetic float32", default=False)
    confidence: float = option("probability that all measured lines lie in the discs", default=0.95)
    velocity: float = option("velocity of the axis at which it is proven", default=0.05, unit="m/s")
    box: str = option(
        "prove every plant of these tolerances instead, each constant in time: "
        "stiffness=0.2,mass=0.3,dead_time=1sample (that is standard), identified, or none; box_proof.json holds the "
        "proof, which feeddrive check checks, and box_check.py of the package with Python alone",
        default="none",
    )
    max_ms: float | None = option("with --box: the Ms that no plant may exceed", above=1.0, default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    @property
    def name(self) -> str:
        """The name of the machine file or object."""
        return called(self.source)

    def check(self) -> None:
        """Raise ParameterError for a box that cannot be read, and for options that do not belong to it, or to none."""
        boxed = Box.parse(self.box) is not None
        of_discs = {
            "at": self.at,
            "measured": self.measured,
            "motor": self.motor,
            "fit": self.fit,
            "radius": self.radius,
        }
        for name, value in of_discs.items():
            if boxed and value not in ((), None, False):
                raise ParameterError(f"--{name} is about discs, and --box proves the plants of a model: leave one out")
        if self.max_ms is not None and not boxed:
            raise ParameterError("--max-ms is proven over a box: add --box standard, or leave it out")

    def usual_out(self) -> Path:
        return Path("results") / f"certify_{Path(self.name).stem}"


@command(CertifyRequest)
def certify(request: CertifyRequest, progress: Progress) -> Outcome[Any]:
    """Prove that a loop, as implemented, is stable for plants with uncertainty discs; write certificate and report.

    The result is a `Certificate` or, with a box, a `BoxProof` of all plants within tolerances, each constant in time.

    Files are written only if an output directory is named. Raises NotCertifiedError for a loop that cannot be
    certified; the message states the frequency at which the proof fails, and a remedy.
    """
    if isinstance(request.source, Loop):
        machine, loop = None, request.source
    else:
        machine = read_machine(request.source)
        loop = machine.loop(request.axis)
    box = Box.parse(request.box) if machine is None else machine.box(request.box, request.axis)
    if box is not None:
        return _over_box(request, box, loop, machine, progress)
    progress.step("plants")
    plants = _plants(request, loop)
    progress.step("certificate")
    certificate = certify_loop(
        loop,
        plants,
        radius=request.radius,
        beyond=request.beyond,
        arithmetic="float32" if request.float32 else request.arithmetic,
        confidence=request.confidence,
        velocity=request.velocity,
        machine=None if machine is None else source(machine, loop.name),
        made_from=[
            {"file": origin.file, "sha256": origin.sha256}
            for origin in origins((request.measured, request.motor, *request.at))
        ],
    )
    files: dict[str, Path] = {}
    known = {
        "Machine": request.name if machine is None else f"{machine.name}, {request.name}",
        "Law": loop.control.law.kind,
        "Sample time": Text(f"{Quantity(float(loop.sample_time), 's'):6}"),
        "Velocity of the axis": Text(f"{Quantity(request.velocity, 'm/s'):6 SI}"),
    }
    if request.out is not None:
        progress.step("report")
        report = write_certified(certificate, request.out, known, rotary=loop.axis.rotary)
        files = {"Certificate": report.parent / FILE, "Report": report}
    topics = "; ".join(text.partition(":")[0] for text in certificate.outside)
    details = [certificate.document["claim"], *(f"outside: {text}" for text in certificate.outside)]
    guarded = loop.control.guard is not None
    then, notes = ("", ()) if machine is None else exporting(request.name, request.axis, guarded=guarded)
    return Outcome(
        certificate,
        [certificate.table()],
        [f"Not covered: {topics}."],
        details=[*map(sentence, details)],
        files=files,
        rotary=loop.axis.rotary,
        page=partial(certificate_report, certificate, known, rotary=loop.axis.rotary),
        notes=notes,
        then=then,
    )


def _over_box(
    request: CertifyRequest, box: Box, loop: Loop, machine: MachineFile | None, progress: Progress
) -> Outcome[Any]:
    """Prove the loop over a box of plants; write the result and a report.

    Raises ParameterError for a box by standard errors of a loop, which has none.
    """
    if box.deviations and not box.known:
        raise ParameterError(
            "--box identified takes the standard errors of a machine file: give the file that feeddrive identify wrote "
            "in place of a loop, or take --box standard"
        )
    progress.step("plants of the box")
    proof = prove_over_box(
        loop,
        box,
        sensitivity_peak=request.max_ms,
        arithmetic="float32" if request.float32 else request.arithmetic,
        velocity=request.velocity,
    )
    judgment = _BOX[proof.proven]
    said = (
        Text(f"{proof.verdict.capitalize()}: {proof.claim}.")
        if proof.proven
        else Text(f"{judgment.says}: {proof.reason}.")
    )
    remarks = [Text(f"Not covered: {OUTSIDE}.")]
    if proof.proven and proof.stated is None:
        remarks.append(Text(f"{proof.cells} cells are too many for a file that feeddrive check can read."))
    outcome = Outcome(
        proof,
        [proof.table()],
        remarks,
        said,
        rotary=loop.axis.rotary,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
    )
    if request.out is None:
        return outcome
    progress.step("report")
    with new_directory(request.out) as folder:
        written = json.dumps(document(proof, {} if machine is None else source(machine, loop.name)))
        (folder / BOX_FILE).write_text(written + "\n", encoding="utf-8")
        (folder / "report.html").write_text(html(outcome.report()), encoding="utf-8")
    out = Path(request.out)
    return replace(outcome, files={"Proof over the box": out / BOX_FILE, "Report": out / "report.html"})


def certified(
    control: Control, points: Sequence[OperatingPoint | Loop], text: str | None, axis: str
) -> tuple[Certificate | None, str]:
    """Return the certificate of a tuned controller and a summary of it, or None and the reason.

    points  the operating points at which stability is proven
    text    the text of a machine file: the control in that file, with its rounded parameters, is certified
    """
    of_file: dict[str, str] = {}
    try:
        if text is not None:
            with TemporaryDirectory() as folder:
                # read back as a file, so that the certificate covers the digits that were written and not those of the
                # search
                file = Path(folder) / "machine.toml"
                file.write_text(text, encoding="utf-8")
                machine = read_machine(file)
            control, of_file = machine.loop(axis).control, source(machine, axis)
        certificate = certify_loop(
            control, point_plants(points), sample_time=float(points[0].sample_time), machine=of_file
        )
    except FeeddriveError as error:
        # a control without a certificate is still a result: its report states the reason
        return None, str(error)
    return certificate, certificate.sentence()


def source(machine: MachineFile, axis: str) -> dict[str, str]:
    """Return the facts about a machine file that the certificate records: names, axis and SHA-256 digest."""
    file = machine.file
    return {"name": machine.name, "file": Path(file.name).name, "axis": axis, "sha256": digest_of(file.text)}


def _plants(request: CertifyRequest, loop: Loop) -> dict[str, PlantLike]:
    """Return the plants to certify, by name: the axis, as a model or with its measured responses, and those in `at`."""
    plants: dict[str, PlantLike] = {}
    if request.measured is None:
        if request.motor is not None or request.fit:
            raise ParameterError("--motor and --fit need --measured, the response of the axis")
        plants["model"] = loop
    else:
        lines = _responses(request.measured, loop)
        lines += [] if request.motor is None else [_sampled(read_frf(request.motor), loop)]
        # lines alone are fitted; with the loop in front its model is kept, and the lines give the radius of the discs
        plants[stem(request.measured)] = lines if request.fit else [loop, *lines]
    for plant in request.at:
        other = loop_or_response(plant, request.axis)
        # two files may share a stem, and the second plant would silently replace the first
        plants[_unused(stem(plant), plants)] = other if isinstance(other, Loop) else _responses(other, loop)
    return plants


def _responses(file: FrfLike, loop: Loop) -> list[FRF]:
    """Return the single response in a file, or the responses of both encoders, first load and then motor."""
    responses = read_frfs(file)
    if len(responses) == 1:
        return [_sampled(next(iter(responses.values())), loop)]
    by_role = encoders(responses)
    if set(by_role) != {"motor", "load"}:
        raise ParameterError(
            f"{called(file)}: holds {', '.join(responses)}: name the responses of both encoders motor and load"
        )
    return [_sampled(by_role[role], loop) for role in ("load", "motor")]


def _sampled(frf: FRF, loop: Loop) -> FRF:
    """Return a response in m/N, or rad/(N m) for a rotary axis; a missing sample time is set to that of the loop."""
    frf = in_metres(frf.output, frf, None, loop.axis.rotary, loop.axis.actuator.commanded)
    return replace(frf, sample_time=float(loop.sample_time)) if frf.sample_time is None else frf


def _unused(name: str, plants: dict[str, PlantLike]) -> str:
    """Return a name that is not yet used by a plant."""
    count = 2
    free = name
    while free in plants:
        free, count = f"{name} {count}", count + 1
    return free


def write_certified(
    certificate: Certificate, out: str | Path, known: Mapping[str, str], *, rotary: bool = False
) -> Path:
    """Write `certificate.json` and `report.html` into a directory; return the path of the report.

    Raises FileError if the directory cannot be written.
    """
    with new_directory(out) as folder:
        write_certificate(folder / FILE, certificate)
        (folder / "report.html").write_text(
            html(certificate_report(certificate, known, rotary=rotary)), encoding="utf-8"
        )
    return Path(out) / "report.html"


def certificate_report(
    certificate: Certificate, known: Mapping[str, str] | None = None, *, rotary: bool = False
) -> Report:
    """Return the report of a certificate; `known` holds facts about the certified loop."""
    pictures = list(_pictures(certificate))
    name = certificate.document["machine"].get("name", "")
    title = f"{name[:1].upper()}{name[1:]}: a certified loop" if name else "A certified loop"
    outside, assumed = map(capitalized, certificate.outside), map(capitalized, certificate.document["assumed"])
    return Report(
        title,
        "feeddrive certify",
        Verdict((capitalized(f"{certificate.sentence()}."),), good=True),
        (
            Section("result", "Result", (certificate.table(), plants_table(certificate, rotary=rotary))),
            further(pictures[1:]),
            Section(
                "outside",
                "What is outside",
                (Remarks(outside, "", warns=False), Remarks(assumed, "What is assumed", warns=False)),
            ),
            Section("control", "The control", (control_table(certificate),), folded=True),
            facts("What was certified", [*(known or {}).items(), *_words(certificate.document)]),
        ),
        pictures[0],
        rotary,
    )


def _words(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the facts about a certificate: claim, theorem, confidence, SHA-256 and the command that checks it."""
    return [
        ("Claim", document["claim"]),
        ("Theorem", document["theorem"]),
        (
            "Confidence of the measured lines",
            Text(f"{Quantity(document['confidence'], 'share'):6}, all lines together"),
        ),
        ("SHA-256", document["sha256"]),
        ("Check it", f"feeddrive check {FILE}, or with nothing but Python: python check.py {FILE}"),
    ]


def plants_table(certificate: Certificate, *, rotary: bool = False) -> Table:
    """Tabulate the plants with dead time, number of poles at or outside the unit circle, and source of the model."""

    def source(text: str) -> str:
        # the signed texts of the certificate have the units of a linear axis
        return text.replace(" m/s", f" {turning('m/s')}") if rotary else text

    rows = [
        [
            plant["name"],
            float(plant["dead_time_s"]),
            # a free mass has its poles at z = 1, and rounding may put them just inside
            sum(abs(pole) > 1.0 - 1e-12 for pole in certificate.loops[plant["name"]].plant.poles()),
            source(plant["source"]),
        ]
        for plant in certificate.document["plants"]
    ]
    return Table("plants", ["plant", Column("dead time", "s"), "poles at or outside |z| = 1", "model"], rows)


def control_table(certificate: Certificate) -> Table:
    """Tabulate the parameters of the control."""
    control = certificate.document["control"]
    rows = [
        [name, Quantity(value, control["units"][name], form="6 SI"), UNIT]
        for name, value in control["parameters"].items()
    ]
    every = Quantity(1e-3 * certificate.document["sample_time_ms"], "s", form="6")
    title = f"control {control['law']}, {certificate.arithmetic} coefficients, every {every}"
    return Table(title, ["parameter", "value", "unit"], rows)


def _pictures(certificate: Certificate) -> Iterator[Picture]:
    plants = certificate.document["plants"]
    least = "" if all(plant["reserve"] is None for plant in plants) else " The dot is where the discs have least room."
    above = (
        f"1/Σ|H|, one over what a sine of {Quantity(1.0, 'N')} adds to the force there and at its images"
        if certificate.two_rates
        else "the distance of L from -1 over |L|"
    )
    seen = (
        " Green at the lower edge: where the plant was measured."
        if any(any(plant["lines"]) for plant in plants)
        else ""
    )
    yield Picture(
        "margin",
        "Room at each frequency",
        Text(
            f"Proven: the blue curve, {above}, lies above the dashed orange one, the radius of the discs, at every "
            f"frequency; shaded orange is what the discs take.{least}{seen}"
        ),
        "Room around the plant and the radius of the discs over frequency, for each plant.",
        certificate.chart,
    )
    if certificate.two_rates:
        # no separate disc per plant: L combines the plant at a frequency and all its aliases
        return
    yield Picture(
        "discs",
        "Where L may lie",
        "Every loop gain L that a plant in the discs can have lies in the shaded area; -1, the red cross, does not.",
        "Nyquist plot of the loop gain with the discs around it, near -1.",
        lambda: plot.certificate_discs_chart(certificate),
    )


def write_certificate(path: str | Path, certificate: Certificate) -> Path:
    """Write a certificate as JSON, atomically; return its path.

    Raises FileError if it cannot be written, NotCertifiedError if the checker rejects it.
    """
    # a file that the checker would reject must not exist even for a moment
    certificate.verify()
    write_whole(path, certificate.text())
    return Path(path)


def read_certificate(path: str | Path) -> Certificate:
    """Read a certificate from a file. Raise FileError, with the checker's reason, if it is rejected."""
    content = read_whole(path, check.MOST_BYTES)
    try:
        document = check.parse(content)
        check.verified(document)
    except check.RefusedError as error:
        raise FileError(f"{path}: refused: {error}") from None
    # the checker reads the document without a schema, so a malformed one ends in a LookupError, TypeError or the like
    except check.BROKEN as error:
        raise FileError(f"{path}: refused: it does not have the form of a certificate: {error}") from None
    return Certificate(document)
