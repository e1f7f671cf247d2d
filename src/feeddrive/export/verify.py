"""Verification of an export: its code is run on this computer, and the outputs must equal the simulator's exactly."""

import platform
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from feeddrive.export import targets
from feeddrive.export.c_bundle import stepped
from feeddrive.export.design import CONTROL, MACHINE_FILE, Answers, Design, Trial, read_design, trial
from feeddrive.export.targets import Manifest, Proof
from feeddrive.files.atomic_io import files_of, read_whole
from feeddrive.files.origins import digest_of
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import joined
from feeddrive.loop.routine import run
from feeddrive.version import __version__

MOST = 20_000_000  # samples
# samples in single precision: their expected outputs are computed in Python, operation by operation
SINGLE = 5_000


@dataclass(frozen=True, eq=False)
class Verified(Result):
    """The result of a verification.

    worst        largest difference of each output, by name, in its unit; 0 if all bits agree
    differing    number of output values whose bits differ
    altered      files of the export that are missing, changed, or symbolic links
    other_files  files in the directory that are not part of the export; they are neither read nor run
    written_by   version of feeddrive that wrote the export
    digest, export_digest  SHA-256 digests of the machine file and of `export.json`
    """

    name: str
    target: str
    precision: str
    machine: str
    digest: str
    export_digest: str
    program: str
    how: str
    samples: int
    changes: int
    trips: int
    limited: int
    seed: int
    differing: int
    worst: Mapping[str, float]
    against: str
    written_by: str = ""
    altered: Sequence[str] = field(default=())
    other_files: Sequence[str] = field(default=())

    @property
    def holds(self) -> bool:
        """True if all bits agree and no file was altered."""
        return self.differing == 0 and not self.altered

    def _result(self) -> str:
        if self.differing:
            return "NOT EQUAL"
        return "EQUAL, bit for bit" if self.holds else "EQUAL, bit for bit, but CHANGED SINCE THE EXPORT"

    def sentences(self) -> str:
        """Return the verification result as text."""
        table = self.table().grid()
        wide = max(len(row[0]) for row in table.rows)
        return "\n".join([table.title, *(f"  {row[0]:<{wide}}  {row[1]}" for row in table.rows)])

    def record(self) -> str:
        """Return the text of a file with the verification result; its last line is the SHA-256 of the lines above."""
        text = self.sentences() + "\n"
        return f"{text}SHA-256 {digest_of(text)}\n"

    def table(self) -> Table:
        """Return the verification result as a table."""
        worst = joined(", ", (f"{name} {Quantity(value):3}" for name, value in self.worst.items()))
        rows: list[list[str | int]] = [
            ["export", f"{self.name}, target {self.target}, {self.precision} precision"],
            ["machine file", f"{self.machine}, SHA-256 {self.digest}"],
            [targets.FILE, f"SHA-256 {self.export_digest}"],
            ["files as written", "yes" if not self.altered else "no: " + ", ".join(self.altered)],
            *([["files besides", ", ".join(self.other_files)]] if self.other_files else []),
            ["written by", self.written_by],
            ["run by", self.program],
            ["built with", self.how],
            ["on", f"{platform.machine()}, {platform.system()}, feeddrive {__version__}"],
            ["against", self.against],
            ["samples", f"{self.samples}, seed {self.seed}"],
            ["with", f"{self.changes} live changes, {self.trips} trips, {self.limited} samples at the force limit"],
            ["outputs with other bits", self.differing],
            ["worst difference", worst],
            ["result", self._result()],
        ]
        return Table(f"exported code against simulation: {self.name}", ["", ""], rows)


def verify_export(
    directory: str | Path,
    *,
    samples: int | None = None,
    seed: int = 1,
    flags: Sequence[str] = (),
    command: str | None = None,
) -> Verified:
    """Prove on this computer that the results of an export are bit-identical to those of the simulator.

    samples  number of samples in the trial; default: that of the target, a million for C in double precision
    flags    C compiler flags in addition to -std=c99 -O2 -ffp-contract=off; `command` names another compiler

    The exported code is run by the tool of its target, such as FMPy for an FMU. The expected outputs are computed from
    the machine file of the export, in double precision by the simulator of this version, in single precision by the
    same operations in Python, each rounded to single precision.
    A file to be compiled or run is rejected beforehand if any byte differs from a fresh export.

    Raises FileError for such a file, for a directory that is not an export or whose code does not compile,
    MissingProgramError or MissingExtraError if the target's program is missing, and ParameterError for a target that
    cannot run on this computer.
    """
    directory = Path(directory)
    manifest = targets.read_manifest(directory)
    target = targets.TARGETS.get(manifest.target)
    if target is None or target.proof is None:
        why = "is of a target unknown to this version of feeddrive" if target is None else target.unproven
        raise ParameterError(f"{directory}: what the target {manifest.target} writes {why.format(name=manifest.name)}")
    proof = target.proof
    design = _design(directory, manifest)
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        fresh = Path(folder) / "export"
        _write_fresh(fresh, directory, manifest, design)
        altered = _altered(directory, manifest, fresh)
        result = _proven(fresh, design, manifest, altered, proof, samples, seed, flags, command)
        digest = digest_of(read_whole(directory / targets.FILE, targets.MOST_BYTES))
        return replace(
            result,
            export_digest=digest,
            other_files=[name for name in files_of(directory) if not (fresh / name).exists()],
        )


def _write_fresh(fresh: Path, directory: Path, manifest: Manifest, design: Design) -> None:
    try:
        targets.write_again(design, manifest.target, fresh, manifest.options)
    except TypeError as error:
        raise FileError(
            f"{directory / targets.FILE}: is not what `feeddrive export` writes ({error}): export again"
        ) from None


def altered_files(directory: Path) -> list[str]:
    """Return the files of an export that differ from a fresh export of its machine file, with the difference.

    `export.json` is among them. Raises FileError for a directory that is not an export, and ParameterError for the
    export of an axis.
    """
    manifest = targets.read_manifest(directory)
    design = _design(directory, manifest)
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        fresh = Path(folder) / "export"
        _write_fresh(fresh, directory, manifest, design)
        findings = [f"{name} ({how})" for name, how in _differences(directory, manifest, fresh).items()]
        # its list of digests follows the files: another one is another finding only where no file differs
        if not findings and (directory / targets.FILE).read_bytes() != (fresh / targets.FILE).read_bytes():
            findings.append(f"{targets.FILE} (edited)")
    return findings


def _differences(directory: Path, manifest: Manifest, fresh: Path) -> dict[str, str]:
    """Return how files differ from a fresh export, by name; `export.json` is not compared.

    The comparison is with a fresh export of the machine file, since the digests in `export.json` can be edited along
    with a file.
    """
    changed, differing = set(targets.changed_files(directory, manifest)), dict[str, str]()
    for name in files_of(fresh):
        file = directory / name
        if name == targets.FILE:
            continue
        if file.is_symlink():
            differing[name] = "a symbolic link"
        elif not file.exists():
            differing[name] = "missing"
        elif read_whole(file, targets.MOST_BYTES) != (fresh / name).read_bytes():
            differing[name] = "edited" if name in changed else "not what this feeddrive writes"
    return differing


def _altered(directory: Path, manifest: Manifest, fresh: Path) -> list[str]:
    """Return the files that differ from a fresh export. Raise FileError if one of them would be compiled or run."""
    differing = _differences(directory, manifest, fresh)
    findings = [f"{name} ({how})" for name, how in differing.items()]
    # edited notes and wiring are reported, but what would be compiled or run is refused
    run = [f"{name} ({how})" for name, how in differing.items() if not name.endswith(_NOT_RUN)]
    here = f"feeddrive {__version__}"
    if run:
        other = "" if manifest.version == here else f", and this is {here}: verify it there, or export again here"
        raise FileError(
            f"{directory}: {', '.join(run)}: altered since the export, or another state of feeddrive wrote it. Nothing "
            f"was compiled or run. It was written by {manifest.version}{other or '; export again'}"
        )
    return findings


_PLAIN = re.compile(r"""[^\x00-\x1f*"\\/]+""")
_NOT_RUN = (".md", ".hal", ".ini", targets.NEW)  # documentation and wiring files for people


def _proven(
    directory: Path,
    design: Design,
    manifest: Manifest,
    altered: list[str],
    proof: Proof,
    samples: int | None,
    seed: int,
    flags: Sequence[str],
    command: str | None,
) -> Verified:
    """Run the fresh export, which is identical to the checked one and cannot be modified between check and run."""
    single = design.layout.precision == "float"
    count = samples or (min(SINGLE, proof.samples) if single else proof.samples)
    # a short trial has some ten broken numbers, too
    tried = trial(design.routine, count, seed, changes=proof.changes, broken=max(2e-4, 10.0 / count))
    if proof.own_build and (flags or command):
        raise ParameterError(
            f"--compiler and --flag mean nothing for the target {manifest.target}, which has its own build"
        )
    answers = proof.answers(directory, design, tried, flags, command)
    wanted = stepped(design.layout, tried) if single else run(design.routine, tried.inputs, tried.changes)
    return _compared(design, manifest, altered, tried, seed, answers, wanted)


def _design(directory: Path, manifest: Manifest) -> Design:
    """Return the design that the manifest describes, labeled with the machine file from which it was exported."""
    if manifest.what != CONTROL:
        raise ParameterError(f"{directory}: is the export of an axis; compare its run with one of `simulate`")
    file = directory / MACHINE_FILE
    if not file.is_file():
        raise FileError(f"{file}: is missing; export again")
    # the name of a design of all axes is the list of their names
    together = "," in manifest.axis
    axis = None if together else manifest.axis
    design = read_design(file, axis, name=manifest.name, precision=manifest.precision, together=together)
    if not _PLAIN.fullmatch(manifest.source):  # it appears in comments of the code
        raise FileError(
            f"{directory / targets.FILE}: the machine file cannot have been '{manifest.source!r}': export again"
        )
    text = design.machine.file
    called = design.machine.name if text.root().values.get("name") else Path(manifest.source).stem  # as `read_machine`
    named = replace(design.machine, file=replace(text, name=manifest.source), name=called)
    return replace(design, machine=named)


def _compared(
    design: Design,
    manifest: Manifest,
    altered: list[str],
    tried: Trial,
    seed: int,
    answers: Answers,
    wanted: np.ndarray,
) -> Verified:
    paths = [variable.path for variable in design.routine.outputs]
    outputs = answers.outputs
    bits = np.ascontiguousarray(outputs).view(np.uint64) != np.ascontiguousarray(wanted).view(np.uint64)
    # sign and payload of a NaN differ between processors and mean nothing
    bits &= ~(np.isnan(outputs) & np.isnan(wanted))
    with np.errstate(invalid="ignore"):
        apart = np.where(bits, np.abs(outputs - wanted), 0.0).max(axis=0)
    trips = limited = 0
    for port, loop in zip(design.routine.origin.ports(), design.routine.origin.loops().values(), strict=True):
        trip, force = (wanted[:, paths.index(f"{port}{name}")] for name in ("trip", "force"))
        limit = loop.control.force_limit if loop.control.velocity_limit is None else loop.control.velocity_limit
        trips += int(np.sum((trip[1:] > 0.0) & (trip[:-1] == 0.0)))
        limited += 0 if limit is None else int(np.sum(np.abs(force) >= 0.75 * float(limit)))
    double = design.layout.precision == "double"
    return Verified(
        name=design.name,
        target=manifest.target,
        precision=design.layout.precision,
        machine=design.machine.name,
        digest=design.digest,
        export_digest="",
        program=answers.program,
        how=answers.how,
        samples=len(outputs),
        changes=len(tried.changes),
        trips=trips,
        limited=limited,
        seed=seed,
        differing=int(bits.sum()),
        worst=dict(zip((variable.name for variable in design.routine.outputs), apart.tolist(), strict=True)),
        against="the simulator" if double else "the same operations in Python, in single precision",
        altered=altered,
        written_by=manifest.version,
    )
