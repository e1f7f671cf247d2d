"""What accompanies an export: the manifest `export.json`, and the README from its template.

READMEs of exports: the Jinja2 templates of `templates/`, filled as plain text.

A template that names what it was not given is an error; nothing is escaped but `|` in a cell of a table, by the filter
`cell`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.files.atomic_io import read_whole
from feeddrive.language.errors import FileError
from feeddrive.loop.guard import TRIPS
from feeddrive.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

FILE = "export.json"
_MOST = 10_000_000


@dataclass(frozen=True)
class Manifest:
    """What `export.json` holds; `files` are SHA-256 digests by name."""

    target: str
    axis: str
    what: str
    name: str
    precision: str
    machine: str
    digest: str
    version: str
    options: Mapping[str, Any]
    files: Mapping[str, str]


def manifest_text(design: Design, target: str, files: Mapping[str, bytes | str], **options: Any) -> str:
    """The text of `export.json` for an export of these files; `options` are the target's own."""
    content = {
        "export": {
            "target": target, "axis": design.axis, "what": design.what, "name": design.name,
            "precision": design.layout.precision, "options": options,
        },
        "machine": {"name": design.machine.name, "file": MACHINE_FILE, "sha256": design.digest},
        "rules": {str(code): sentence for code, sentence in design.routine.sentences.items()},
        "made_by": f"feeddrive {__version__}",
        "files": {name: _digest(content) for name, content in sorted(files.items())},
    }  # fmt: skip
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def read_manifest(directory: Path) -> Manifest:
    """The manifest of an export. Raises FileError if it is not there, malformed, or of another kind."""
    file = directory / FILE
    if not directory.is_dir():
        raise FileError(f"{directory}: is not a directory; give the one that `feeddrive export` wrote")
    if not file.exists():
        raise FileError(f"{directory}: holds no {FILE}; give a directory that `feeddrive export` wrote")
    try:
        found = json.loads(read_whole(file, _MOST))
        said, machine = found["export"], found["machine"]
        manifest = Manifest(
            target=_text(said["target"]), axis=_text(said["axis"]), what=_text(said["what"]), name=_text(said["name"]),
            precision=_text(said["precision"]), machine=_text(machine["name"]), digest=_text(machine["sha256"]),
            version=_text(found["made_by"]), options=dict(said["options"]),
            files={_text(name): _text(digest) for name, digest in found["files"].items()},
        )  # fmt: skip
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(f"{file}: is not what `feeddrive export` writes ({error}): export again") from None
    return manifest


def changed_files(directory: Path, manifest: Manifest) -> list[str]:
    """Files of an export that are missing or not as they were written."""
    wrong = []
    for name, digest in manifest.files.items():
        file = directory / name
        if not file.resolve().is_relative_to(directory.resolve()):
            raise FileError(f"{directory / FILE}: names the file '{name}' outside the export: export again")
        if not file.is_file() or _digest(read_whole(file, _MOST)) != digest:
            wrong.append(name)
    return wrong


def _digest(content: bytes | str) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a text")
    return value


def readme(template: str, design: Design, **content: Any) -> str:
    """The README of a design in Markdown. Pure: the same content gives the same text.

    template  a file of `templates/`; beside `content` it has `design`, `routine`, `P` (the prefix of all names),
              `title`, `made_by`, `control` (true for a control, false for an axis) and `trips`
    """
    return (
        _environment()
        .get_template(template)
        .render(
            design=design,
            routine=design.routine,
            P=design.name,
            title=design.title,
            made_by=design.made_by,
            control=design.what == CONTROL,
            trips=TRIPS,
            **content,
        )
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("feeddrive.export"),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters["cell"] = _cell
    return made


def _cell(text: str) -> str:
    """A text for a cell of a table in Markdown."""
    return text.replace("|", "\\|")
