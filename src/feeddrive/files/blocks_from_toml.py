"""A block from a TOML table, read by the declarations and type annotations of its fields.

    [axis.x.plant]
    kind = "two_mass"            # selects the block of the family; not needed where only one block fits
    mass_load = 350.0            # a parameter in the unit of its declaration
    stiffness_N_per_um = 180     # or in another unit of the same dimension, appended to the key
    [[axis.x.forces]]            # a part is a section, a tuple of parts a list of sections
    kind = "cogging"

Every error is one sentence: file and line, key, value, bound, unit, what to do.  `blocks_to_toml.py` is the inverse.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np

from feeddrive.blocks.catalogue import OPT_IN, RENAMED, catalogue
from feeddrive.files.toml_file import Section
from feeddrive.language import units
from feeddrive.language.block import Block, checked
from feeddrive.language.declaration import Declaration, declarations
from feeddrive.language.errors import ParameterError, StructureError, nearest, shown
from feeddrive.language.quantity import Quantity

Choice: TypeAlias = Any  # the type of a choice: int, str, bool, float, tuple[...] or a union of them


@dataclass(frozen=True)
class Hint:
    """The type of a part: blocks of these families or classes; `many`: a list of them; `optional`: may be absent."""

    classes: tuple[type[Block], ...]
    many: bool = False
    optional: bool = False

    def single(self) -> bool:
        """True if only one class fits, so that `kind` need not be written."""
        return len(self.classes) == 1 and not inspect.isabstract(self.classes[0])


@cache
def hints(kind: type[Block]) -> Mapping[str, Any]:
    """By name the Hint of every part and the type of every choice."""
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
        raise section.error(f"{where} must be >= {Quantity(declared.least):6}", key)
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
    """A type in words: `a whole number`."""
    if _is_union(annotation):
        return " or ".join(map(type_as_text, options_of_type(annotation)))
    if typing.get_origin(annotation) is tuple:
        return f"a list, each entry {type_as_text(typing.get_args(annotation)[0])}"
    return _TYPES.get(annotation, str(annotation))


B = TypeVar("B", bound=Block)
_A_PROGRAM = (
    "an FMU is a program with no linear model, and nothing that a file names is executed; give the plant that it "
    "resembles, for margins and tuning, and run the FMU by  feeddrive cosimulate JOB FMU"
)


def read_block(
    family: type[B], section: Section, besides: Iterable[str] = (), given: Mapping[str, Any] | None = None
) -> B:
    """The block of a family that a section describes.

    Keys named in `besides` are read elsewhere; fields in `given` are set already and not read.

    Raises ParameterError (a key is unknown, missing, given twice, of another type, not finite or out of bounds) or
    StructureError (parts that do not fit each other), both with file and line.
    """
    return _block(Hint((family,)), section, set(besides), given or {})


def _block(
    hint: Hint, section: Section, besides: Iterable[str] = (), given: Mapping[str, Any] = MappingProxyType({})
) -> Any:
    kind = _kind(hint, section)
    declared = {name: each.of_axis(section.rotary) for name, each in declarations(kind).items()}
    fields = hints(kind)
    found: dict[str, Any] = dict(given)
    keys: dict[str, str] = {}
    for key, value in section.values.items():
        if key == "kind" or key in besides:
            continue
        name, factor = _named(kind, key, section)
        if name in keys:
            raise section.error(
                f"{section.dotted(name)} is given twice, as {keys[name]} and as {key}; remove one of them", key
            )
        keys[name] = key
        match declared[name].role:
            case "parameter":
                found[name] = _number(section, key, name, declared[name], value, factor)
            case "table":
                found[name] = _row(section, key, name, declared[name], value, factor)
            case "choice":
                found[name] = choice_value(section, key, declared[name], fields[name], value)
            case _:
                found[name] = _part(section, key, fields[name])
    _refuse_missing(kind, section, found)
    try:
        with np.errstate(all="ignore"):  # a value near 1e308 overflows in a check, which then refuses it
            return kind(**found)
    except (ParameterError, StructureError) as error:
        raise type(error)(f"{section.where()}: {_prefix(section)}{error}") from None
    except ArithmeticError:
        raise section.error(
            f"{_prefix(section)}{kind.kind} has a value too small or too large to compute with"
        ) from None


def _prefix(section: Section) -> str:
    return f"{section.dotted()}: " if section.key else ""


def _kind(hint: Hint, section: Section) -> type[Block]:
    """The class that `kind` names, or the only one that fits."""
    fitting = members(hint)
    given = section.values.get("kind")
    if given is None:
        if hint.single():
            return hint.classes[0]
        raise section.error(f"{_prefix(section)}kind is missing; there are: {', '.join(fitting) or 'none'}")
    if given == "fmu":
        raise section.error(f"{section.dotted('kind')} = 'fmu': {_A_PROGRAM}", "kind")
    if isinstance(given, str) and RENAMED.get(given) in fitting:
        raise section.error(f"{section.dotted('kind')} = {shown(given)} is now called '{RENAMED[given]}'", "kind")
    if not isinstance(given, str) or given not in fitting:
        raise section.error(
            f"{section.dotted('kind')} = {shown(given)} is not known{nearest(str(given), fitting)}; {OPT_IN}", "kind"
        )
    return fitting[given]


def _named(kind: type[Block], key: str, section: Section) -> tuple[str, float]:
    """The field that a key means, and the factor to its unit."""
    declared = {name: each.of_axis(section.rotary) for name, each in declarations(kind).items() if each.role != "label"}
    if key in declared:
        return key, 1.0
    wrong = ""
    for name in sorted(declared, key=len, reverse=True):
        if not key.startswith(f"{name}_") or declared[name].role not in ("parameter", "table"):
            continue
        unit = key[len(name) + 1 :]
        try:
            return name, units.factor(unit, declared[name].unit)
        except ParameterError as error:
            wrong = wrong or f"; if {name} is meant: {error}, it is declared in '{declared[name].unit or '1'}'"
    raise section.error(
        f"key '{section.dotted(key)}' is not known to {kind.kind}{wrong or nearest(key, declared)}", key
    )


def _number(section: Section, key: str, name: str, declared: Declaration, value: Any, factor: float) -> float:
    if isinstance(value, str):
        raise section.error(
            f"{section.dotted(key)} = {shown(value)} ({declared.meaning}) must be a number without quotes; "
            f"another unit than {declared.unit or '1'} is named in the key, as in stiffness_N_per_um",
            key,
        )
    try:
        whole = isinstance(value, int | float) and not isinstance(value, bool)
        number = units.scaled(_float(value), factor) if whole else value
        return checked("", section.dotted(name), declared, number)
    except ParameterError as error:
        given = "" if key == name else f" (given as {key} = {shown(value)})"
        raise section.error(f"{error}{given}", key) from None


def _float(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _row(section: Section, key: str, name: str, declared: Declaration, value: Any, factor: float) -> Any:
    if not isinstance(value, list):
        raise section.error(f"{section.dotted(key)} ({declared.meaning}) must be a list of numbers: [1.0, 2.0]", key)
    row: list[float] = []
    for place, item in enumerate(value):
        if isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(_float(item)):
            entry = f"entry {place + 1} = {shown(item)}"
            raise section.error(f"{section.dotted(key)}: {entry} ({declared.meaning}) must be a finite number", key)
        row.append(units.scaled(_float(item), factor))
    try:
        return checked("", section.dotted(name), declared, row)
    except ParameterError as error:
        raise section.error(f"{error}", key) from None


def _part(section: Section, key: str, hint: Hint) -> Any:
    if hint.many:
        return tuple(_block(hint, each) for each in section.listed(key))
    return _block(hint, section.section(key))


def _refuse_missing(kind: type[Block], section: Section, found: dict[str, Any]) -> None:
    missing = [name for name in declarations(kind) if name not in found and name not in defaults(kind)]
    if not missing:
        return
    declared = {name: each.of_axis(section.rotary) for name, each in declarations(kind).items()}
    described = ", ".join(f"{name} ({', '.join(filter(None, _described(declared[name])))})" for name in missing)
    raise section.error(f"{_prefix(section)}{kind.kind} needs {described}")


def _described(declared: Declaration) -> tuple[str, ...]:
    return declared.unit, declared.meaning, str(declared.bounds())
