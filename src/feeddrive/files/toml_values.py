"""Values of a TOML file: a text as TOML quotes it, and a file with other values of some keys, as a study gives them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

from feeddrive.files.toml_file import Key, TomlFile
from feeddrive.language.errors import ParameterError


def quoted(text: str) -> str:
    """Return a text as a basic string of TOML; no character of it is lost."""
    # JSON's escapes are TOML's, but JSON leaves DEL as it is, which TOML forbids
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def with_values(file: TomlFile, values: Mapping[Key, Any]) -> TomlFile:
    """Return the file with other values of some keys, as if they were written in it; lines stay.

    Raises ParameterError for a key in a section that is not there.
    """
    content: Any = deepcopy(file.content)
    for key, value in values.items():
        table: Any = content
        for part in key[:-1]:
            inside = isinstance(table, dict) and part in table
            if not inside and not (isinstance(table, list) and isinstance(part, int) and part < len(table)):
                raise ParameterError(f"{file.name}: there is no section [{'.'.join(map(str, key[:-1]))}]")
            held: Any = table  # by a name or by a number, as has just been asked
            table = held[part]
        if not isinstance(table, dict):
            raise ParameterError(f"{file.name}: {'.'.join(map(str, key[:-1]))} is no section")
        table[key[-1]] = value
    return replace(file, content=content)
