"""The kinds of files that users write, each with its top-level section type, and their JSON Schemas; the schema of what
every command prints with `--json`.

The schemas are written by `python -m feeddrive.workflow.schemas docs/schema`.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from feeddrive.benchmark.rules import Rules
from feeddrive.bus.drive_file import DriveFile
from feeddrive.export.linuxcnc_file import LinuxcncFile
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.job import JobSection
from feeddrive.files.machine import LimitsSection, MachineSection
from feeddrive.files.mapping import ChannelsSection
from feeddrive.files.schema import DIALECT, Schema, schema_of
from feeddrive.files.section import Section
from feeddrive.language.judgment import Judgment
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


def outcome_schema() -> Schema:
    """Return the schema of the JSON object that every command prints with `--json` (`Outcome.record`)."""
    text: Schema = {"type": "string"}
    unit: Schema = {"type": "string", "description": "SI unit; empty for a plain number"}
    quantity = _object(
        {
            "value": {"type": ["number", "null"], "description": "null if it is not finite"},
            "unit": unit,
            "error": {"type": ["number", "null"], "description": "standard error, in the same unit"},
        },
        "a number with a unit of its own",
        optional=("error",),
    )
    column = _object(
        {"head": text, "unit": {"type": ["string", "null"], "description": "SI unit of plain numbers in this column"}},
        "a column of a table",
    )
    cell = {"anyOf": [{"type": ["number", "string", "boolean", "null"]}, {"$ref": "#/$defs/quantity"}]}
    table = _object(
        {
            "title": text,
            "columns": {"type": "array", "items": {"$ref": "#/$defs/column"}},
            "rows": {"type": "array", "items": {"type": "array", "items": cell}},
        },
        "a table of as many cells a row as it has columns",
    )
    error = _object({"kind": text, "message": text}, "an error: the name of its class, and what it says")
    tables: Schema = {"type": "array", "items": {"$ref": "#/$defs/table"}}
    texts: Schema = {"type": "array", "items": text}
    code: Schema = {"enum": [0, 1, 2, 130], "description": "the exit code of the command"}
    done = _object(
        {
            "command": text,
            "judgment": {"enum": [judgment.name.lower() for judgment in Judgment]},
            "exit_code": code,
            "tables": tables,
            "texts": {**texts, "description": "sentences between the tables"},
            "remarks": texts,
            "verdict": text,
            "notes": texts,
            "failure": text,
            "section": {**text, "description": "what may be pasted into a TOML file"},
            "files": {"type": "object", "additionalProperties": text, "description": "paths of what was written"},
            "next": {**text, "description": "the command that usually follows; may be empty"},
            "details": _object({"tables": tables, "texts": texts}, "what the terminal shows with --verbose"),
            "error": {"anyOf": [{"type": "null"}, {"$ref": "#/$defs/error"}]},
        },
        "the outcome of a command",
    )
    refused = _object({"command": text, "exit_code": code, "error": {"$ref": "#/$defs/error"}}, "no outcome: an error")
    return {
        "$schema": DIALECT,
        "title": "feeddrive --json",
        "oneOf": [done, refused],
        "$defs": {"quantity": quantity, "column": column, "table": table, "error": error},
    }


def _object(members: Mapping[str, Any], description: str, optional: tuple[str, ...] = ()) -> Schema:
    return {
        "type": "object",
        "description": description,
        "properties": dict(members),
        "required": [name for name in members if name not in optional],
        "additionalProperties": False,
    }


def write_schemas(folder: str | Path) -> list[Path]:
    """Write `machine.schema.json` and the others, and `outcome.schema.json`, into a folder. Raise FileError."""
    written: list[Path] = []
    for name, schema in {**schemas(), "outcome": outcome_schema()}.items():
        written.append(Path(folder) / f"{name}.schema.json")
        # editors show the texts of a schema as they stand, so µ and Ω are not escaped
        write_whole(written[-1], json.dumps(schema, indent=2, ensure_ascii=False) + "\n")
    return written


if __name__ == "__main__":
    write_schemas(sys.argv[1])
