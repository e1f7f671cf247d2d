"""An FMU before it runs: an archive that is unpacked, described and checked.  An FMU is a program: see `opened`."""

from __future__ import annotations

import contextlib
import tempfile
import zipfile
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feeddrive.files.atomic_io import refusal
from feeddrive.language.errors import FmuError, MissingExtraError

MOST = 2_000_000_000  # bytes that are unpacked


@dataclass(frozen=True)
class Archive:
    """An unpacked FMU: its file, its description as FMPy reads it, its folder, and its library for this machine."""

    name: str
    description: Any
    folder: Path
    library: Path

    @property
    def three(self) -> bool:
        """Whether it is of FMI 3.0; else it is of FMI 2.0."""
        return str(self.description.fmiVersion).startswith("3.")

    @property
    def model(self) -> str:
        """The identifier of the model, which names its library."""
        return self.description.coSimulation.modelIdentifier


@contextlib.contextmanager
def opened(path: str | Path) -> Generator[Archive]:
    """An FMU, unpacked for the length of the block; nothing of it is run yet.

    Raises FileError for a file that cannot be read, FmuError for one that is no FMU, has no co-simulation or
    no binary for this machine, and MissingExtraError without FMPy.
    """
    fmpy = importer()
    with tempfile.TemporaryDirectory(prefix="feeddrive-fmu-", ignore_cleanup_errors=True) as folder:
        try:
            with zipfile.ZipFile(path) as packed:
                _check_entries(packed, path)
                packed.extractall(folder)
            description = fmpy.read_model_description(folder, validate=False)
        except OSError as error:
            raise refusal(path, "read", error) from None
        except FmuError:
            raise
        except Exception as error:  # a ZIP or an XML file can be broken in ways that only their readers know
            raise FmuError(f"{path}: is no sound FMU: {_first_line(error)}") from None
        yield _checked(str(path), description, Path(folder))


def importer() -> Any:
    """FMPy. Raises MissingExtraError without it."""
    try:
        import fmpy
    except ImportError:
        raise MissingExtraError("fmpy", "fmu", "running an FMU") from None
    return fmpy


def _check_entries(packed: zipfile.ZipFile, path: str | Path) -> None:
    """An FMU has a description, stays in its folder and fits on the disk."""
    names = packed.namelist()
    if "modelDescription.xml" not in names:
        raise FmuError(f"{path}: is not an FMU: it holds no modelDescription.xml")
    outside = [name for name in names if name.startswith(("/", "\\")) or ".." in Path(name).parts or ":" in name]
    if outside:
        raise FmuError(f"{path}: is not an FMU: its file '{outside[0]}' would lie outside its folder")
    size = sum(each.file_size for each in packed.infolist())
    if size > MOST:
        raise FmuError(
            f"{path}: would take {size / 1e9:.3g} GB unpacked, more than the {MOST / 1e9:g} GB that are read"
        )


def _checked(name: str, description: Any, folder: Path) -> Archive:
    fmpy = importer()
    if description.fmiVersion == "1.0":
        raise FmuError(f"{name}: is of FMI 1.0; FMI 2.0 and 3.0 can be run")
    if description.coSimulation is None:
        raise FmuError(f"{name}: is no FMU for co-simulation (it has no solver of its own): export it as one that is")
    three = str(description.fmiVersion).startswith("3.")
    here = fmpy.platform_tuple if three else fmpy.platform
    file = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    library = folder / "binaries" / here / file
    if not library.is_file():
        there = sorted({each.parent.name for each in (folder / "binaries").glob("*/*") if each.is_file()})
        has = f"has binaries for {', '.join(there)}" if there else "has no binary"
        advice = f"compile it:  fmpy compile {name}" if description.buildConfigurations else "ask its maker for one"
        raise FmuError(f"{name}: {has}, but none for this machine ({here}): {advice}")
    return Archive(name, description, folder, library)


def _first_line(error: Exception) -> str:
    """What an error says, in a line; never nothing."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
