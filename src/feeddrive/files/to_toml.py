"""A block as TOML text that `from_toml.py` reads back bit for bit; every key with unit and meaning."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from feeddrive.files.from_toml import Hint, hints
from feeddrive.files.toml_values import quoted
from feeddrive.language.block import Block
from feeddrive.language.declaration import Declaration, declarations
from feeddrive.language.errors import StructureError

_COMMENTS = 34  # column at which comments begin
_ROW = 6  # numbers of a table on one line


def to_toml(block: Block, key: str = "", *, listed: bool = False, rotary: bool = False) -> str:
    """Return the block as the section `[key]`, as an entry `[[key]]` of a list, or as a whole file without a key.

    rotary   it is a part of an axis that turns: comments name rad, N m and kg m2

    An absent parameter is written as a comment.  Raises StructureError for a block that holds arrays of variants.
    """
    header = f"[[{key}]]" if listed else f"[{key}]" if key else ""
    return (
        "\n".join(
            _lines(block, key, header, named=True, rotary=rotary or bool(getattr(block, "rotary", False)))
        ).strip()
        + "\n"
    )


def _lines(block: Block, key: str, header: str, *, named: bool, rotary: bool) -> Iterator[str]:
    kind = type(block)
    yield ""
    summary = (kind.__doc__ or "").strip().split("\n")[0]
    if header:
        yield header
    if named:
        yield _line(f'kind = "{kind.kind}"', summary)
    elif summary:
        yield f"# {summary}"
    below: list[str] = []
    for name, declaration in declarations(kind).items():
        declared, value = declaration.of_axis(rotary), getattr(block, name)
        if declared.role == "part":
            hint: Hint = hints(kind)[name]
            if value is None or value == ():
                yield f"# {name}: none ({declared.meaning})"
            below += _part(value, f"{key}.{name}" if key else name, hint, rotary)
        elif declared.role == "label":
            continue
        elif value is None:
            yield _line(f"# {name} =", _meaning(declared))
        else:
            yield _line(f"{name} = {_value(name, declared, value)}", _meaning(declared))
    yield from below


def _part(value: Any, key: str, hint: Hint, rotary: bool) -> Iterator[str]:
    if isinstance(value, tuple):
        for item in value:
            yield from _lines(item, key, f"[[{key}]]", named=not hint.single(), rotary=rotary)
    elif value is not None:
        yield from _lines(value, key, f"[{key}]", named=not hint.single(), rotary=rotary)


def _line(entry: str, comment: str) -> str:
    if not comment:
        return entry
    return f"# {comment}\n{entry}" if "\n" in entry else f"{entry.ljust(_COMMENTS)} # {comment}"


def _meaning(declared: Declaration) -> str:
    allowed = f"one of {', '.join(map(str, declared.options))}" if declared.options else str(declared.bounds())
    meaning = f"{declared.unit}: {declared.meaning}" if declared.unit else declared.meaning
    return f"{meaning} ({allowed})" if allowed else meaning


def _value(name: str, declared: Declaration, value: Any) -> str:
    if declared.role == "table":
        return _list([repr(float(item)) for item in value])
    if declared.role == "parameter":
        if not isinstance(value, float):
            raise StructureError(f"{name} holds variants, not one number; a file describes one block")
        return repr(value)
    return _choice(value)


def _list(items: list[str]) -> str:
    if len(items) <= _ROW:
        return f"[{', '.join(items)}]"
    rows = [", ".join(items[k : k + _ROW]) for k in range(0, len(items), _ROW)]
    return "[\n" + "".join(f"    {row},\n" for row in rows) + "]"


def _choice(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return _list([_choice(item) for item in value])
    if isinstance(value, str):
        return quoted(value)
    return repr(value)
