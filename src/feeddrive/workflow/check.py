"""`feeddrive check`: check a certificate in exact arithmetic, and whether the files around it belong together.

The files form a chain: logs and responses -> machine file -> certificate, and machine file -> export -> verification.
Each names the SHA-256 digests of those that it was made from.  A digest binds names only: a certificate of other gains
may name the digest of a machine file.  So the control and the plants of the certificate are computed again from the
machine file, and the files of the export are written again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.certificate import box_check, box_proof, travel_check
from feeddrive.certificate.certificate import control_of, matrices
from feeddrive.certificate.certify import CLAIM, OUTSIDE, THEOREM, THEOREM_OF_TWO_RATES
from feeddrive.certificate.check import MOST_BYTES, checked
from feeddrive.certificate.systems import deployed, modelled_plant
from feeddrive.export import targets
from feeddrive.export.verify import altered_files
from feeddrive.files.atomic_io import read_whole
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import Origin, digest_of
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import Lifted, StateSpace
from feeddrive.workflow.command import Outcome, Request, argument, command, option

# other versions of numpy may round the last bits of a matrix differently; a gain that was edited is off by far more
_ROUNDING = 1e-9  # of the largest number of the matrix
_ARITHMETIC = {"double": "float64", "float": "float32"}  # of the coefficients, by the precision of an export
_HEAD = 200  # bytes at the beginning of a file, among which its format stands
_LISTED = 3  # parameters that differ, by name
_SHOWN = 12  # digits of a digest that identify a file for a reader


class CheckRequest(Request):
    """The certificate to check, and the files that may belong to it."""

    file: Path = argument("A certificate, or a proof along a travel or over a box (JSON)")
    machine: MachineLike | None = option("machine file of the certificate and of --export", short="-m", default=None)
    export: Path | None = option("the directory that `feeddrive export` wrote", default=None)
    source: tuple[Path, ...] = option(
        "a file that --machine or the certificate was made from: a log, responses, an older machine file; repeat",
        default=(),
    )
    verified: Path | None = option("what `feeddrive verify --out` wrote for --export", default=None)


@dataclass(frozen=True)
class Link:
    """A link of the chain: the two files, True if they belong together, and what was compared or differs."""

    files: str
    holds: bool
    finding: str


@command(CheckRequest)
def check(request: CheckRequest, progress: Progress) -> Outcome[bool]:
    """Check a certificate in exact arithmetic, and whether machine file, export and their sources belong to it.

    The result is True if the certificate is proven and every link of the chain holds. Otherwise the outcome names each
    file that does not belong to the others, with the difference.
    Raises FileError for a missing file, and ParameterError for options without the file that they refer to.
    """
    if not request.file.exists():
        raise FileError(f"{request.file}: no such file")
    if request.machine is None and (request.export is not None or request.source):
        raise ParameterError("--export and --source are compared with the machine file: give it as --machine FILE")
    if request.verified is not None and request.export is None:
        raise ParameterError("--verified is the verification of an export: give its directory as --export DIR")
    progress.step(f"checking {request.file}")
    other = _other_proof(request.file)
    if other == ALONG_TRAVEL and request.machine is not None:
        raise ParameterError(
            f"--machine is compared with a certificate, and this is a {other}: leave it out; the digests of its "
            "machine files stand in the file"
        )
    lines, proven = (checked if other is None else _OTHERS[other])(str(request.file))
    if request.machine is None:
        return Outcome(proven, lines, judgment=Judgment.PROVEN if proven else Judgment.NOT_PROVEN)
    machine = read_machine(request.machine)
    progress.step(f"comparing with {machine.file.name}")
    document = _document(request.file) if proven else None
    stated = _stated(request, machine, document)
    links = [*_links(request, machine, document, stated)]
    broken = [link for link in links if not link.holds]
    rows = [[link.files, "holds" if link.holds else "BROKEN", link.finding] for link in links]
    table = Table("chain of files", ["files", "link", Column("finding", sentences=True)], rows)
    given = {source.name for source in request.source}
    names = dict.fromkeys(origin.file for _, made_from in stated for origin in made_from)
    missing = [name for name in names if name not in given]
    remarks = [f"Not given, and not compared: {', '.join(missing)} (--source)."] if missing else []
    if not proven:
        return Outcome(False, [*lines, table], remarks, judgment=Judgment.NOT_PROVEN)
    if broken:
        verdict = f"{Judgment.NOT_TOGETHER.says}: {'; '.join(link.files for link in broken)}"
        return Outcome(False, [*lines, table], remarks, f"{verdict}.", judgment=Judgment.NOT_TOGETHER)
    verdict = f"{Judgment.TOGETHER.says}: {len(links)} links were compared."
    return Outcome(True, [*lines, table], remarks, verdict, judgment=Judgment.TOGETHER)


# proofs that another checker checks, by what they are
ALONG_TRAVEL, OVER_BOX = "proof along a travel", "proof over a box"
_OTHERS = {ALONG_TRAVEL: travel_check.checked, OVER_BOX: box_check.checked}
_FORMATS = {travel_check.FORMAT: ALONG_TRAVEL, box_check.FORMAT: OVER_BOX}


def _other_proof(file: Path) -> str | None:
    """Return what a file of `feeddrive travel --certify` or `feeddrive certify --box` is; None for a certificate."""
    with file.open("rb") as opened:
        head = opened.read(_HEAD)
    return next((name for form, name in _FORMATS.items() if form.encode() in head), None)


def _document(file: Path) -> Mapping[str, Any]:
    return json.loads(read_whole(file, MOST_BYTES))


def _stated(
    request: CheckRequest, machine: MachineFile, document: Mapping[str, Any] | None
) -> list[tuple[str, tuple[Origin, ...]]]:
    """Return the origins that each file states: machine file, certificate, and the machine files among the sources."""
    stated = [(Path(machine.file.name).name, machine.made_from)]
    if document is not None:
        stated.append((request.file.name, tuple(Origin(**origin) for origin in document.get("made_from", []))))
    for source in request.source:
        # a log is no machine file, and neither is a machine file that was damaged, which its digest names
        with suppress(FeeddriveError):
            stated.append((source.name, read_machine(source).made_from))
    return stated


def _links(
    request: CheckRequest,
    machine: MachineFile,
    document: Mapping[str, Any] | None,
    stated: Sequence[tuple[str, Sequence[Origin]]],
) -> Iterator[Link]:
    """Yield the links between the given files; those of a certificate that is not proven are left out."""
    name, digest = Path(machine.file.name).name, digest_of(machine.file.text)
    if document is not None:
        of_file = _of_box_proof if document["format"] == box_check.FORMAT else _of_certificate
        yield from of_file(f"{request.file.name}, {name}", document, machine, digest)
    if request.export is not None:
        yield from _of_export(request.export, name, digest, document)
        if request.verified is not None:
            yield _of_verification(request.verified, request.export, digest)
    yield from _of_sources(request.source, stated)


def _of_certificate(files: str, document: Mapping[str, Any], machine: MachineFile, digest: str) -> Iterator[Link]:
    """Yield the links of a certificate: the digest that it names, its control, and its plants."""
    yield _of_machine(files, document, digest)
    try:
        axis = machine.named(document["machine"].get("axis") or None)
        differing = [*_other_control(document, machine, axis)]
        own, other = _plants(document, machine, axis)
    except FeeddriveError as error:
        yield Link(f"{files}: control and plants", False, f"cannot be computed again: {error}")
        return
    finding = "; ".join(differing) or f"the matrices are those of axis {axis}, computed again"
    yield Link(f"{files}: control", not differing, finding)
    texts = [key for key, wanted in _TEXTS.items() if document.get(key) not in wanted]
    if texts:
        yield Link(f"{files}: texts", False, f"{', '.join(texts)}: not a text that certify writes")
    if own:
        further = f"; of another machine, position or load, and not compared: {', '.join(other)}" if other else ""
        yield Link(f"{files}: plants", True, f"{', '.join(own)}: the model of axis {axis}, computed again{further}")
    else:
        yield Link(f"{files}: plants", False, f"{', '.join(other)}: not the model of axis {axis} of the machine file")


def _of_machine(files: str, document: Mapping[str, Any], digest: str) -> Link:
    """Return the link between a certificate or proof and the machine file that it names."""
    stated = document["machine"].get("sha256", "")
    if not stated:
        return Link(files, False, "the certificate names no machine file: certify the file itself")
    if stated != digest:
        return Link(files, False, _another(f"the machine file {document['machine'].get('file', '')}", stated, digest))
    return Link(files, True, f"SHA-256 {digest[:_SHOWN]}...")


def _of_box_proof(files: str, document: Mapping[str, Any], machine: MachineFile, digest: str) -> Iterator[Link]:
    """Yield the links of a proof over a box: the digest that it names, its control, and its box of plants."""
    yield _of_machine(files, document, digest)
    try:
        axis = machine.named(document["machine"].get("axis") or None)
        loop, box = machine.loops[axis], machine.box(document["box"], axis)
        if box is None:
            raise ParameterError(f"box = {document['box']} must be a box of plants")
        velocity = float(document["velocity_m_s"])
        control = deployed(loop.control, float(loop.sample_time), document["arithmetic"], velocity).model
        if not isinstance(control, StateSpace):
            raise ParameterError("the law of the machine file has two rates")
        again = box_proof.stated(loop, box.upright(), control)
    except FeeddriveError as error:
        yield Link(f"{files}: control and plants", False, f"cannot be computed again: {error}")
        return
    for what, names in (("control", ("control", "sample_time_s")), ("plants", ("plant", "uncertain", "late_samples"))):
        wrong = [name for name in names if not _alike(document[name], again[name])]
        finding = f"computed again, and another one: {', '.join(wrong)}" if wrong else f"axis {axis}, computed again"
        yield Link(f"{files}: {what}", not wrong, finding)


def _alike(one: Any, other: Any) -> bool:
    """Return True if two values of JSON are equal, up to the rounding of another version of numpy."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        numbers = [np.array(part) for part in (one, other)]
        if all(part.dtype.kind in "if" for part in numbers):
            a, b = numbers
            if a.shape != b.shape:
                return False
            # entry by entry: next to gains in N/m a pole of the control is small
            slack = _ROUNDING * np.abs(b) + np.finfo(float).eps * np.max(np.abs(b), initial=0.0)
            return bool(np.all(np.abs(a - b) <= slack))
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=_ROUNDING)
    return bool(one == other)


def _other_control(document: Mapping[str, Any], machine: MachineFile, axis: str) -> Iterator[str]:
    """Yield the differences between the control of a certificate and that of the machine file, computed again."""
    loop, entry = machine.loops[axis], document["control"]
    control, T = loop.control, float(loop.sample_time)
    stated = float.fromhex(document["sample_time_s"])
    if stated != T:
        yield Text(f"sample time {Quantity(stated, 's'):6} and, in the machine file, {Quantity(T, 's'):6}")
    if entry.get("law") != control.law.kind:
        yield f"law {entry.get('law')} and, in the machine file, {control.law.kind}"
    numbers, parameters = {name: float(value) for name, value in tree.leaves(control)}, entry.get("parameters", {})
    units = {name: tree.declaration(control, name).unit for name in numbers}
    changed = [name for name in dict.fromkeys([*numbers, *parameters]) if parameters.get(name) != numbers.get(name)]
    for name in changed[:_LISTED]:
        one, other = (_value(values.get(name), units.get(name, "")) for values in (parameters, numbers))
        yield Text(f"{name} = {one} and, in the machine file, {other}")
    if len(changed) > _LISTED:
        yield f"{len(changed) - _LISTED} more parameters"
    if entry.get("units") != units:
        yield "other units of parameters"
    again = deployed(control, T, document["arithmetic"], float(document.get("velocity", _VELOCITY)))
    if {name: value.hex() for name, value in again.numbers.items()} != document["numbers"]:
        yield "other coefficients"
    if not _same(control_of(entry, stated), again.model):
        yield "other matrices"


# the sentences for readers, which the checker does not check
_TEXTS = {"claim": [CLAIM], "theorem": [THEOREM, THEOREM_OF_TWO_RATES], "outside": [OUTSIDE]}
_VELOCITY = 0.05  # m/s, at which the certificates of 0.1.0, which do not name it, linearized friction


def _value(value: Any, unit: str) -> str:
    return "none" if value is None else Text(f"{Quantity(float(value), unit):9 SI}")


def _plants(document: Mapping[str, Any], machine: MachineFile, axis: str) -> tuple[list[str], list[str]]:
    """Return the names of the plants that are the model of the axis, and those of all others."""
    loop, T = machine.loops[axis], float.fromhex(document["sample_time_s"])
    readings, velocity = document["control"]["readings"], float(document.get("velocity", _VELOCITY))
    again = modelled_plant("model", loop.axis, loop.control, T, readings, velocity)
    own, other = list[str](), list[str]()
    for plant in document["plants"]:
        facts = plant["dead_time_s"] == again.dead_time and plant["source"].startswith(again.source)
        same = facts and _same(matrices(plant["model"], ["cut"], readings, T), again.model)
        (own if same else other).append(str(plant["name"]))
    return own, other


def _same(one: StateSpace | Lifted, other: StateSpace | Lifted) -> bool:
    """Return True if two models have the same matrices, up to the rounding of another version of numpy."""
    samples = [model.samples if isinstance(model, Lifted) else (model,) for model in (one, other)]
    if len(samples[0]) != len(samples[1]):
        return False
    pairs = [(getattr(a, name), getattr(b, name)) for a, b in zip(*samples, strict=True) for name in "ABCD"]
    return all(
        a.shape == b.shape and bool(np.all(np.abs(a - b) <= _ROUNDING * np.max(np.abs(b), initial=0.0)))
        for a, b in pairs
    )


def _of_export(directory: Path, name: str, digest: str, document: Mapping[str, Any] | None) -> Iterator[Link]:
    """Yield the links of an export: its files, its machine file, and axis and arithmetic of the certificate."""
    manifest = targets.read_manifest(directory)
    # before the rest: a damaged machine file, or another prefix, makes no export that could be compared
    inside = digest_of(read_whole(directory / targets.MACHINE_FILE, targets.MOST_BYTES))
    try:
        altered = altered_files(directory)
    except FeeddriveError as error:
        altered = [f"nothing could be written again from {targets.MACHINE_FILE} and {targets.FILE}: {error}"]
    if inside != manifest.digest:
        altered.insert(0, f"{targets.MACHINE_FILE} (not the one whose digest {targets.FILE} names)")
    finding = ", ".join(altered) or "every file is what this feeddrive writes again from the machine file inside"
    yield Link(f"{directory.name}: files", not altered, finding)
    files = f"{directory.name}, {name}"
    if manifest.digest != digest or inside != digest:
        other = manifest.digest if manifest.digest != digest else inside
        yield Link(files, False, _another(f"the machine file {manifest.source}", other, digest))
    else:
        yield Link(files, True, f"SHA-256 {digest[:_SHOWN]}...")
    if document is None:
        return
    axis, arithmetic = document["machine"].get("axis", manifest.axis), document["arithmetic"]
    wrong = [] if axis == manifest.axis else [f"the certificate is of axis {axis}, the export of {manifest.axis}"]
    if _ARITHMETIC[manifest.precision] != arithmetic:
        wanted = _ARITHMETIC[manifest.precision]
        wrong.append(
            f"the certificate proves {arithmetic} coefficients, and the export computes with {wanted}: certify with "
            f"--arithmetic {wanted}"
        )
    yield Link(f"{directory.name}, certificate", not wrong, "; ".join(wrong) or f"axis {axis}, {arithmetic}")


def _of_verification(file: Path, directory: Path, digest: str) -> Link:
    """Return the link between an export and the record of its verification."""
    text = read_whole(file, targets.MOST_BYTES).decode("utf-8", "replace")
    above, _, own = text.rstrip("\n").rpartition("\nSHA-256 ")
    exported = digest_of(read_whole(directory / targets.FILE, targets.MOST_BYTES))
    wrong = []
    if not above or digest_of(above + "\n") != own:
        wrong.append("its last line is not the digest of the lines above: it was changed, or is no record of verify")
    if digest not in above:
        wrong.append("it is of another machine file")
    if exported not in above:
        wrong.append("it is of another export, or export.json was changed since")
    if not above.rstrip().endswith("EQUAL, bit for bit") or "NOT EQUAL" in above:
        wrong.append("its result is not EQUAL")
    return Link(
        f"{file.name}, {directory.name}", not wrong, "; ".join(wrong) or f"of this export, {exported[:_SHOWN]}..."
    )


def _of_sources(sources: Sequence[Path], stated: Sequence[tuple[str, Sequence[Origin]]]) -> Iterator[Link]:
    """Yield a link for each source and each file that states a source of its name or content."""
    for source in sources:
        digest, matched = digest_of(read_whole(source, MOST_BYTES)), False
        for file, made_from in stated:
            for origin in made_from:
                if origin.sha256 == digest:
                    matched = True
                    yield Link(f"{source.name}, {file}", True, f"SHA-256 {digest[:_SHOWN]}...")
                elif origin.file == source.name:
                    matched = True
                    yield Link(f"{source.name}, {file}", False, _another(f"a {origin.file}", origin.sha256, digest))
        if not matched:
            named = ", ".join(f"{origin.file} ({origin.sha256[:_SHOWN]}...)" for _, made in stated for origin in made)
            yield Link(f"{source.name}", False, f"none of the files was made from it; they name {named or 'no file'}")


def _another(what: str, stated: str, digest: str) -> str:
    return (
        f"was made from {what} with SHA-256 {stated[:_SHOWN]}..., and this file has {digest[:_SHOWN]}...: one of the "
        "two was changed or exchanged"
    )
