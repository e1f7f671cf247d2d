"""The manifest `export.json` and the README of an export, and the writing of its directory.

The README is rendered as plain text from a Jinja2 template in `templates/`. An undefined name in a template is an
error. Only `|` in a table cell is escaped, by the filter `cell`.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.export.c_code import rules
from feeddrive.export.design import CONTROL, MACHINE_FILE, Design
from feeddrive.export.targets import TARGETS
from feeddrive.files.atomic_io import new_directory, read_whole
from feeddrive.language.errors import FileError
from feeddrive.loop.guard import TRIPS
from feeddrive.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

FILE = "export.json"
NEW = ".new"  # behind the name of a file whose older edit was kept
MOST_BYTES = 10_000_000  # of a file


@dataclass(frozen=True)
class Manifest:
    """The content of `export.json`; `source` is the name of the machine file, `files` are SHA-256 digests by name."""

    target: str
    axis: str
    what: str
    name: str
    precision: str
    machine: str
    source: str
    digest: str
    version: str
    options: Mapping[str, Any]
    files: Mapping[str, str]


def manifest_text(design: Design, target: str, files: Mapping[str, bytes | str], **options: Any) -> str:
    """Return the text of `export.json` for an export of these files; `options` are target-specific."""
    told = rules(design.routine) if TARGETS[target].in_c else design.routine.sentences
    content = {
        "export": {
            "target": target,
            "axis": design.axis,
            "what": design.what,
            "name": design.name,
            "precision": design.layout.precision,
            "options": options,
        },
        "machine": {
            "name": design.machine.name,
            "file": MACHINE_FILE,
            "source": Path(design.machine.file.name).name,
            "sha256": design.digest,
        },
        "rules": {str(code): sentence for code, sentence in told.items()},
        "made_by": f"feeddrive {__version__}",
        "files": {name: _digest(content) for name, content in sorted(files.items())},
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def write_bundle(design: Design, target: str, out: Path, files: Mapping[str, bytes | str], **options: Any) -> Path:
    """Write an export atomically: `files`, the machine file and `export.json`; return the path of the README.

    An edited file of an older export (its digest differs from `export.json`) is kept, and the new file is written as
    NAME`.new`; `edits_kept` lists them.

    Raises FileError as `new_directory` does, and for a directory whose `export.json` does not describe its content.
    """
    whole: dict[str, bytes | str] = {**files, MACHINE_FILE: design.machine.file.text}
    whole[FILE] = manifest_text(design, target, whole, **options)
    with new_directory(out) as folder:
        for name, content in (_beside_edits(out, whole) if (out / FILE).exists() else whole).items():
            file = folder / name
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(content.encode() if isinstance(content, str) else content)
    return out / "README.md"


def _beside_edits(out: Path, files: Mapping[str, bytes | str]) -> dict[str, bytes | str]:
    """Return the files to write, including the edited files of the older export, which are kept."""
    contents = dict(files)
    for name in changed_files(out, read_manifest(out)):
        if not (out / name).is_file():
            continue
        edit = read_whole(out / name, MOST_BYTES)
        if name in files and _digest(files[name]) != _digest(edit):
            contents[f"{name}{NEW}"] = files[name]
        contents[name] = edit
    return contents


def edits_kept(directory: Path) -> list[str]:
    """Return a message for each edited file that was kept, with the name of the new file."""
    kept = sorted(str(file.relative_to(directory))[: -len(NEW)] for file in directory.rglob(f"*{NEW}"))
    return [
        f"{directory / name}: was edited since the last export and is kept; the new file is {name}{NEW} beside it: "
        "take over what you need, and remove one of the two"
        for name in kept
    ]


def read_manifest(directory: Path) -> Manifest:
    """Read the manifest of an export. Raises FileError if it is missing, malformed, or of another kind."""
    file = directory / FILE
    if not directory.is_dir():
        raise FileError(f"{directory}: is not a directory; give the one that `feeddrive export` wrote")
    if not file.exists():
        raise FileError(f"{directory}: holds no {FILE}; give a directory that `feeddrive export` wrote")
    try:
        document = json.loads(read_whole(file, MOST_BYTES))
        export, machine = document["export"], document["machine"]
        manifest = Manifest(
            target=_text(export["target"]),
            axis=_text(export["axis"]),
            what=_text(export["what"]),
            name=_text(export["name"]),
            precision=_text(export["precision"]),
            machine=_text(machine["name"]),
            source=_text(machine["source"]),
            digest=_text(machine["sha256"]),
            version=_text(document["made_by"]),
            options=dict(export["options"]),
            files={_text(name): _text(digest) for name, digest in document["files"].items()},
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(f"{file}: is not what `feeddrive export` writes ({error}): export again") from None
    return manifest


def changed_files(directory: Path, manifest: Manifest) -> list[str]:
    """Return the files of an export that are missing or modified."""
    wrong = []
    for name, digest in manifest.files.items():
        file = directory / name
        if not Path(os.path.abspath(file)).is_relative_to(os.path.abspath(directory)):
            raise FileError(f"{directory / FILE}: names the file '{name}' outside the export: export again")
        if file.is_symlink() or not file.is_file() or _digest(read_whole(file, MOST_BYTES)) != digest:
            wrong.append(name)
    return wrong


def _digest(content: bytes | str) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a text")
    return value


def readme(template: str, design: Design, **content: Any) -> str:
    """Return the README of a design in Markdown. It is deterministic: the same content gives the same text.

    template  a file of `templates/`; besides `content` it receives `design`, `routine`, `P` (the prefix of all names),
              `title`, `made_by`, `control` (true for a control, false for an axis), `trips` and `c_rules`
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
            c_rules=rules(design.routine),
            **content,
        )
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("feeddrive.export"),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["cell"] = _cell
    return environment


def _cell(text: str) -> str:
    """Return a text escaped for a cell of a Markdown table."""
    return text.replace("|", "\\|")
