"""`feeddrive doctor`: what feeddrive needs on this computer, what is missing, and the command that installs it.

Nothing is installed or changed. Missing extras and programs are no fault: each serves the commands that are named
beside it. The exit code is 1 only if feeddrive itself does not work here.

Other rooms are imported where they are asked: with a package that is broken this file must still say so.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import NamedTuple

from feeddrive.language.errors import MissingProgramError
from feeddrive.language.judgment import Judgment
from feeddrive.language.machine_code import cache_directory
from feeddrive.language.progress import Progress
from feeddrive.language.table import Result, Table
from feeddrive.version import __version__
from feeddrive.workflow.command import Outcome, Request, command

EXTRAS = {
    "studio": "the page in the browser",
    "bus": "drives over EtherCAT and CANopen",
    "matlab": "logs in files of MATLAB 7.3 and HDF5",
    "uff": "responses in universal files (UFF)",
    "fmu": "running an FMU",
    "cluster": "sweeps and benchmarks on a Dask cluster",
    "pandas": "results as a DataFrame",
    "control": "models for python-control",
    "testing": "the tests of a law of your own",
}
"""What each extra of the package is for; those that only development needs are not listed."""

DEVELOPMENT = ("dev", "docs")
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"""extra\s*==\s*['"]([^'"]+)['"]""")


class DoctorRequest(Request):
    """The request has no options."""


class Part(NamedTuple):
    """A part that feeddrive uses.

    name      package, extra or program
    purpose   what it is for
    found     its version or place; empty if it is missing
    remedy    what to type if it is missing
    required  True if feeddrive does not work without it
    """

    name: str
    purpose: str
    found: str
    remedy: str
    required: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class Installation(Result):
    """All parts that feeddrive uses, and whether they are there."""

    parts: tuple[Part, ...]

    @property
    def broken(self) -> tuple[Part, ...]:
        """The required parts that are missing."""
        return tuple(part for part in self.parts if part.required and not part.found)

    @property
    def missing(self) -> tuple[Part, ...]:
        """The optional parts that are missing."""
        return tuple(part for part in self.parts if not part.required and not part.found)

    def table(self) -> Table:
        rows = [
            [part.name, part.purpose, part.found or ("MISSING" if part.required else "not there"),
             "" if part.found else part.remedy]
            for part in self.parts
        ]  # fmt: skip
        return Table(f"feeddrive {__version__} on this computer", ["part", "for", "found", "what to type"], rows)


@command(DoctorRequest)
def doctor(_: DoctorRequest, progress: Progress) -> Outcome[Installation]:
    """List what feeddrive needs on this computer, what of it is there, and how the rest is installed.

    A bundled axis is simulated for 20 ms, which shows that loops are compiled and run.
    """
    progress.step("looking at the packages")
    parts = [*_system(), *_packages()]
    if not any(part.required and not part.found for part in parts):
        progress.step("simulating a bundled axis")
        parts += [simulation(), *_programs()]
    found = Installation((*parts, *_extras()))
    if found.broken:
        names = ", ".join(part.name for part in found.broken)
        return Outcome(
            found,
            [found.table()],
            verdict=f"{Judgment.DOES_NOT_WORK.says}: {names}: {found.broken[0].remedy}.",
            judgment=Judgment.DOES_NOT_WORK,
        )
    count = len(found.missing)
    more = "nothing is missing" if not count else f"{count} optional part{'s are' if count > 1 else ' is'} not there"
    return Outcome(
        found,
        [found.table()],
        verdict=f"{Judgment.WORKS.says}; {more}.",
        judgment=Judgment.WORKS,
        then="feeddrive demo",
    )


def _system() -> Iterator[Part]:
    yield Part("Python", f"{platform.system()}, {os.cpu_count()} cores", platform.python_version(), "", required=True)
    folder = cache_directory()
    yield Part(
        "cache of machine code",
        "a quicker start of every command",
        "" if folder is None else str(folder),
        "set FEEDDRIVE_CACHE to a folder of your own that others cannot write to",
    )


def simulation() -> Part:
    """Return whether a bundled axis can be simulated: the part `simulation`, whose remedy has the error."""
    # a package may be damaged in any way
    try:
        from feeddrive.blocks.reference.linear_move import LinearMove
        from feeddrive.files.machine import read_machine
        from feeddrive.loop.simulate import simulate

        run = simulate(read_machine("linear_motor").loop("x"), LinearMove(distance=1e-4, travel_time=0.02))
        samples = run.time.size
    except Exception as error:
        return Part("simulation", "loops as machine code", "", f"{type(error).__name__}: {error}", required=True)
    return Part("simulation", "loops as machine code", f"{samples} samples of a bundled axis", "", required=True)


def requirements() -> Mapping[str, tuple[str, ...]]:
    """Return the names of the packages that feeddrive declares, by extra; those it always needs under an empty name.

    Empty if feeddrive was not installed by a package manager, which writes this list.
    """
    found: dict[str, list[str]] = {}
    try:
        declared = metadata.requires("feeddrive") or []
    except metadata.PackageNotFoundError:
        return {}
    for line in declared:
        name, extra = _NAME.match(line), _EXTRA.search(line)
        if name is not None:
            found.setdefault(extra[1] if extra else "", []).append(name[0])
    return {extra: tuple(names) for extra, names in found.items()}


def _packages() -> Iterator[Part]:
    for name in requirements().get("", ()):
        try:
            import_module(name)
        except Exception as error:
            remedy = f"pip install --force-reinstall {name}   ({type(error).__name__}: {error})"
            yield Part(name, "all of feeddrive", "", remedy, required=True)
        else:
            yield Part(name, "all of feeddrive", metadata.version(name), "", required=True)


def _extras() -> Iterator[Part]:
    declared = requirements()
    for extra, purpose in EXTRAS.items():
        versions = [_version(name) for name in declared.get(extra, ())]
        found = ", ".join(f"{name} {version}" for name, version in versions if version)
        complete = bool(versions) and all(version for _, version in versions)
        yield Part(f"extra {extra}", purpose, found if complete else "", f"pip install 'feeddrive[{extra}]'")


def _version(package: str) -> tuple[str, str]:
    try:
        return package, metadata.version(package)
    except metadata.PackageNotFoundError:
        return package, ""


def _programs() -> Iterator[Part]:
    from feeddrive.export import cortex_m, linuxcnc_session
    from feeddrive.export.c_bundle import compiler
    from feeddrive.path.program import reading

    purpose = "comparing exported C and its FMU with the simulation"
    try:
        yield Part("C compiler", purpose, compiler()[0], "")
    except MissingProgramError as missing:
        yield Part("C compiler", purpose, "", missing.remedy)
    yield _group("LinuxCNC", "building and running exported components", linuxcnc_session.PACKAGES)
    yield _group("rs274 of LinuxCNC", "part programs with codes of lathes", {reading.PROGRAM: reading.PACKAGE})
    yield _group("Cortex-M", "running exported C on an emulated Cortex-M", cortex_m.PACKAGES)
    page = Path(sys.modules["feeddrive"].__file__ or "").parent / "studio" / "page" / "index.html"
    built = str(page) if page.is_file() else ""
    yield Part("page of the studio", "the page in the browser", built, "make page   (in the clone; needs node and npm)")


def _group(name: str, purpose: str, packages: Mapping[str, str]) -> Part:
    places = {program: shutil.which(program) for program in packages}
    absent = [packages[program] for program, place in places.items() if place is None]
    found = "" if absent else next(str(place) for place in places.values())
    return Part(name, purpose, found, MissingProgramError.install(absent))
