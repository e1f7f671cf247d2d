"""What the last release promised to keep: public names, commands with their options, keys of files, keys of `--json`.

`python tests/promised.py` writes `promised.json` from the code; `tests/released.py` refuses a release that it does not
describe.  docs/reference/stability.md says what is promised.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import stubs
from feeddrive.cli.commands import OFFERED, offered
from feeddrive.export.targets import TARGETS
from feeddrive.version import __version__
from feeddrive.workflow.command import fields_of
from feeddrive.workflow.schemas import outcome_schema, schemas

FILE = Path(__file__).parent / "promised.json"


def promised() -> dict[str, list[str]]:
    """What there is now, by kind."""
    return {
        "names": sorted(f"{package}.{name}" for package, names in stubs.packages() for name in names),
        "commands": sorted(_commands()),
        "keys": sorted(key for name, schema in schemas().items() for key in _keys(schema, name)),
        "json": sorted(_keys(outcome_schema(), "outcome")),
        "targets": sorted(TARGETS),
    }


def _commands() -> Iterator[str]:
    for name in OFFERED:
        yield name
        for field in fields_of(offered(name).request):  # type: ignore[arg-type]
            yield f"{name} {field.flag or field.name}"


def _keys(schema: Any, at: str) -> Iterator[str]:
    """Keys of a schema by their path; those of a definition by its name, since definitions refer to each other."""
    for name, defined in schema.get("$defs", {}).items():
        yield from _keys(defined, f"{at}#{name}")
    for name, member in schema.get("properties", {}).items():
        yield f"{at}.{name}"
        yield from _keys(member, f"{at}.{name}")
    for word in ("oneOf", "anyOf", "allOf"):
        for part in schema.get(word, ()):
            yield from _keys(part, at)
    for word in ("items", "additionalProperties"):
        if isinstance(schema.get(word), dict):
            yield from _keys(schema[word], at)


def lost(before: dict[str, Any], now: dict[str, list[str]]) -> list[str]:
    """What was promised and is not there any more."""
    return [f"{kind}: {name}" for kind, names in now.items() for name in sorted({*before[kind]} - {*names})]


if __name__ == "__main__":
    FILE.write_text(json.dumps({"version": __version__, **promised()}, indent=1) + "\n", encoding="utf-8")
