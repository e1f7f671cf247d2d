"""The kinds of files that users write, each with its top-level section type, and their JSON Schemas.

The schemas are written by `python -m feeddrive.workflow.schemas docs/schema`.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from feeddrive.benchmark.rules import Rules
from feeddrive.bus.drive_file import DriveFile
from feeddrive.export.linuxcnc_file import LinuxcncFile
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.job import JobSection
from feeddrive.files.machine import LimitsSection, MachineSection
from feeddrive.files.mapping import ChannelsSection
from feeddrive.files.schema import Schema, schema_of
from feeddrive.files.section import Section
from feeddrive.study.study import StudySection

FILES: Mapping[str, type[Section]] = {
    "machine": MachineSection,
    "job": JobSection,
    "study": StudySection,
    "channels": ChannelsSection,
    "drive": DriveFile,
    "linuxcnc": LinuxcncFile,
    "limits": LimitsSection,
    "rules": Rules,
}
"""The section type at the top level of each kind of file, by the name of the kind."""


def schemas() -> dict[str, Schema]:
    """Return the schema of each kind of file, by name."""
    return {name: schema_of(section, name) for name, section in FILES.items()}


def write_schemas(folder: str | Path) -> list[Path]:
    """Write `machine.schema.json` and the other schemas into a folder. Raise FileError if they cannot be written."""
    written: list[Path] = []
    for name, schema in schemas().items():
        written.append(Path(folder) / f"{name}.schema.json")
        # editors show the texts of a schema as they stand, so µ and Ω are not escaped
        write_whole(written[-1], json.dumps(schema, indent=2, ensure_ascii=False) + "\n")
    return written


if __name__ == "__main__":
    write_schemas(sys.argv[1])
