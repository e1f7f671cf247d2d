"""What a file needs to know of a block's fields beyond their declarations: their types, from the annotations."""

from __future__ import annotations

import dataclasses
import inspect
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from feeddrive.blocks.catalogue import catalogue
from feeddrive.files.messages import shown
from feeddrive.files.toml_lines import Section
from feeddrive.language.block import Block, Declaration, declarations

Choice: TypeAlias = Any  # the type of a choice: int, str, bool, float, tuple[...] or a union of them


@dataclass(frozen=True)
class Hint:
    """What a part may be: blocks of these families or classes; `many` of them in a row, or `optional`ly none."""

    classes: tuple[type[Block], ...]
    many: bool = False
    optional: bool = False

    def single(self) -> bool:
        """True if only one class fits, so that `kind` need not be written."""
        return len(self.classes) == 1 and not inspect.isabstract(self.classes[0])


@cache
def hints(kind: type[Block]) -> Mapping[str, Any]:
    """For every part its Hint, for every choice its type."""
    resolved = typing.get_type_hints(kind)
    found: dict[str, Any] = {}
    for name, declared in declarations(kind).items():
        if declared.role == "part":
            found[name] = part_hint(resolved[name])
        elif declared.role == "choice":
            found[name] = resolved[name]
    return found


def part_hint(annotation: Any) -> Hint:
    """The Hint of `Plant`, `Friction | None` or `tuple[Force, ...]`."""
    if typing.get_origin(annotation) is tuple:
        inner = part_hint(typing.get_args(annotation)[0])
        return Hint(inner.classes, many=True)
    if _is_union(annotation):
        inner = [part_hint(each) for each in options_of_type(annotation)]
        return Hint(
            tuple(found for each in inner for found in each.classes),
            many=any(each.many for each in inner),
            optional=types.NoneType in typing.get_args(annotation),
        )
    return Hint((annotation,))


def _is_union(annotation: Any) -> bool:
    return typing.get_origin(annotation) in (typing.Union, types.UnionType)


def options_of_type(annotation: Choice) -> tuple[Choice, ...]:
    """The types of a union but None, or the only type."""
    if not _is_union(annotation):
        return (annotation,)
    return tuple(each for each in typing.get_args(annotation) if each is not types.NoneType)


def members(hint: Hint) -> dict[str, type[Block]]:
    """Kind -> class of every block that fits."""
    found: dict[str, type[Block]] = {}
    for family in hint.classes:
        found.update({family.kind: family} if not inspect.isabstract(family) else catalogue().get(family, {}))
    return found


@cache
def defaults(kind: type[Block]) -> Mapping[str, Any]:
    """The defaults of the fields that have one."""
    return {
        spec.name: spec.default
        for spec in dataclasses.fields(kind)  # type: ignore[arg-type]
        if spec.default is not dataclasses.MISSING
    }


def choice_value(section: Section, key: str, declared: Declaration, annotation: Choice, value: Any) -> Any:
    """The value of a choice in its own type. Raises ParameterError that names what is allowed."""
    held = _in_type(annotation, value)
    where = f"{section.dotted(key)} = {shown(value)} ({declared.meaning})"
    if declared.options:
        allowed = [option for option in declared.options if type(option) is type(held) and option == held]
        if not allowed:
            listed = ", ".join(_as_text(option) for option in declared.options if option is not None)
            raise section.error(f"{where} must be one of {listed}", key)
        return allowed[0]
    if held is None:
        raise section.error(f"{where} must be {type_as_text(annotation)}", key)
    if declared.least is not None and held < declared.least:
        raise section.error(f"{where} must be >= {declared.least:g}", key)
    return held


def _as_text(option: Any) -> str:
    if isinstance(option, bool):
        return "true" if option else "false"
    return f'"{option}"' if isinstance(option, str) else str(option)


def _in_type(annotation: Choice, value: Any) -> Any:
    """The value if it is of the type, lists as tuples; None if it is not."""
    if _is_union(annotation):
        tried = (_in_type(each, value) for each in options_of_type(annotation))
        return next((found for found in tried if found is not None), None)
    if typing.get_origin(annotation) is tuple:
        return _tuple_in_type(typing.get_args(annotation), value)
    if annotation is float and type(value) is int:
        return float(value)
    return value if type(value) is annotation else None


def _tuple_in_type(inner: tuple[Any, ...], value: Any) -> tuple[Any, ...] | None:
    if not isinstance(value, list):
        return None
    expected = [inner[0]] * len(value) if inner[1:] == (Ellipsis,) else list(inner)
    if len(expected) != len(value):
        return None
    held = tuple(_in_type(each, item) for each, item in zip(expected, value, strict=True))
    return None if None in held else held


_TYPES = {int: "a whole number", str: 'text in quotes ("...")', bool: "true or false", float: "a number"}


def type_as_text(annotation: Choice) -> str:
    """A type as people say it: `a whole number`."""
    if _is_union(annotation):
        return " or ".join(map(type_as_text, options_of_type(annotation)))
    if typing.get_origin(annotation) is tuple:
        return f"a list, each entry {type_as_text(typing.get_args(annotation)[0])}"
    return _TYPES.get(annotation, str(annotation))
