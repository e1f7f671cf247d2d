"""Sections: the schema of a table in a user's file as a dataclass of declared fields, and its conversion from TOML.

    class LogSection(Section):
        \"\"\"A measured log, whose reference is replayed.\"\"\"
        file: str | None = file_name("name of the log, beside the job", default=None)
        skip_samples: int = choice("samples to skip at the start", least=0, default=0)
        sample_time: Number | None = parameter("s", "sample time of a log without a time column", above=0, default=None)

The reader below, the JSON Schema (`schema.py`) and the reference pages of the keys all use these declarations.
Sections have the fields of blocks (`language/block.py`): `parameter`, `choice`, `table`, `part`, and in addition
    text()      a free text
    file_name() the name of a file
    named()     sections or values by name: `[axis.x]`, `[axis.y]`
    numbers()   numbers by the path of a parameter, written in quotes or as nested tables
A part is a block, a section, or a tuple of them (`[[law]]`).

Tables of TOML become blocks or sections by these declarations:

    [axis.x.plant]
    kind = "two_mass"            # selects the block of the family; not needed where only one block fits
    mass_load = 350.0            # a parameter in the unit of its declaration
    stiffness_N_per_um = 180     # or in another unit of the same dimension, appended to the key
    [[axis.x.forces]]            # a part becomes a section, and a tuple of parts a list of sections
    kind = "cogging"

Every error is one sentence: file and line, key, value, bound, unit, remedy.  `to_toml` is the inverse for blocks.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, replace
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from feeddrive.blocks.catalogue import OPT_IN, RENAMED, catalogue, member
from feeddrive.files.toml_file import Key, TomlTable, quoted
from feeddrive.language import units
from feeddrive.language.block import (
    Block,
    Declaration,
    Declared,
    checked,
    choice,
    declarations,
    defaults,
    parameter,
    part,
    snake_case,
    table,
)
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError, nearest, shown
from feeddrive.language.quantity import Quantity

VARIED = "*"
"""The unit of a field whose unit follows from the content of its section, such as that of a varied parameter."""
ROLES_OF_SECTIONS = ("text", "file", "named", "numbers")


def text(meaning: str, *, default: Any = MISSING, example: str = "", shortest: int = 0) -> Any:
    """Declare a text field of at least `shortest` characters; `example` is shown in error messages."""
    declaration = Declaration(role="text", unit="", meaning=meaning, example=example, shortest=shortest)
    return dataclasses.field(default=default, metadata={"declaration": declaration})


def file_name(meaning: str, *, default: Any = MISSING, example: str = "") -> Any:
    """Declare a field for a file name."""
    declaration = Declaration(role="file", unit="", meaning=meaning, example=example)
    return dataclasses.field(default=default, metadata={"declaration": declaration})


def named(
    meaning: str,
    *,
    least: int = 0,
    names: tuple[str, ...] = (),
    pattern: str = "",
    example: str = "",
    absent: bool = False,
) -> Any:
    """Declare a dict of sections or values by name.

    least     smallest number of entries; if > 0, the field is required
    names     all allowed names, if they are fixed
    pattern   regular expression for allowed names; `example` is shown in error messages
    absent    True if the field is None when the section is missing
    """
    declaration = Declaration(
        role="named", unit="", meaning=meaning, options=names, pattern=pattern, example=example, shortest=least
    )
    metadata = {"declaration": declaration}
    if absent:
        return dataclasses.field(default=None, metadata=metadata)
    if least:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default_factory=dict, metadata=metadata)


def numbers(meaning: str, *, default: Any = MISSING, example: str = "") -> Any:
    """Declare a dict of numbers in SI units by path; `example` is the hint shown for a value of another type."""
    declaration = Declaration(role="numbers", unit="", meaning=meaning, example=example)
    return dataclasses.field(default=default, metadata={"declaration": declaration})


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(parameter, choice, table, part, text, file_name, named, numbers),
)
class Section(Declared):
    """Base of all sections. Subclasses become frozen, keyword-only dataclasses that check themselves.

    kind       name of the section in schema and documentation
    exactly    tuples of fields; fields of exactly one of these tuples must be present
    needs      error message for a section in which the fields of none or of several of these tuples are present
    shorthand  field that receives the string if a plain string is given in place of the section
    wanted     accepted values of a section with a shorthand, for messages
    needs_kind True if the key `kind` is required, since another class of the family is the default
    inlined    field name -> section whose keys appear directly in this section if the field is absent
    is_open    True if undeclared keys belong to other readers and are ignored
    read_from  the table from which the section was read
    """

    kind: ClassVar[str] = ""
    exactly: ClassVar[tuple[tuple[str, ...], ...]] = ()
    needs: ClassVar[str] = ""
    shorthand: ClassVar[str] = ""
    wanted: ClassVar[str] = ""
    needs_kind: ClassVar[bool] = False
    inlined: ClassVar[Mapping[str, type[Section]]] = MappingProxyType({})
    is_open: ClassVar[bool] = False
    # Set on the instance by the reader. Not a field, since it is no content of the section.
    read_from: ClassVar[TomlTable | None] = None

    def __init_subclass__(cls, kind: str = "") -> None:
        cls.kind = kind or snake_case(cls.__name__.removesuffix("Section"))
        dataclass(frozen=True, kw_only=True, eq=False)(cls)
        for spec in dataclasses.fields(cls):  # type: ignore[arg-type]
            if "declaration" not in spec.metadata:
                raise StructureError(f"{cls.__name__}.{spec.name} must be declared as a field of a section")

    @classmethod
    def choose(cls, table: TomlTable) -> type[Section]:
        """Return the class that reads a table; families of sections override it. Raise ParameterError if none fits."""
        return cls

    def __post_init__(self) -> None:
        there = [name for name in declarations(type(self)) if getattr(self, name) is not None]
        wrong = self.refused_alternatives(there)
        if wrong:
            raise self.error(wrong)
        super().__post_init__()

    @classmethod
    def refused_alternatives(cls, names: Collection[str]) -> str:
        """Return the error message if `names` does not meet the condition `exactly`, otherwise an empty string."""
        first = [next((name for name in fields if name in names), None) for fields in cls.exactly]
        there = [name for name in first if name is not None]
        if not cls.exactly or len(there) == 1:
            return ""
        written = " and ".join(f"[{name}]" if "[" in cls.needs else name for name in there)
        return f"{cls.needs}, not {written}" if there else cls.needs

    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        # Identity, not equality: arrays do not compare to one truth value, and a default was declared valid.
        if declaration.role in ROLES_OF_SECTIONS or value is defaults(type(self)).get(name, MISSING):
            return value
        return checked(self.kind, name, declaration, value)

    def error(self, message: str, name: str | Key = (), kind: type[FeeddriveError] = ParameterError) -> FeeddriveError:
        """Return an error for this section or a key in it, with file and line if it was read from a file."""
        table = self.read_from
        return kind(message) if table is None else table.error(message, self._written(table, name), kind)

    def _written(self, table: TomlTable, name: str | Key) -> str | Key:
        """Return a key as it stands in the file: a number may have its unit behind its name."""
        if not isinstance(name, str) or not name or name in table.values:
            return name
        own = declarations(type(self))
        return next((key for key in table.values if key.startswith(f"{name}_") and key not in own), name)

    def dotted(self, name: str = "") -> str:
        """Return the dotted name of the section or of a key in it: `law.2.name`."""
        return name if self.read_from is None else self.read_from.dotted(name or ())


_COMMENTS = 34  # column at which comments begin
_ROW = 6  # numbers of a table on one line


def to_toml(block: Block, key: str = "", *, listed: bool = False, rotary: bool = False) -> str:
    """Return a block as the section `[key]`, as an entry `[[key]]` of a list or, without a key, as a whole file.

    rotary   True for a block of a rotary axis: comments state rad, N m and kg m2

    An absent parameter is written as a comment.  Raises StructureError for a block whose parameters are arrays of
    variants.
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
            below += _part_text(value, f"{key}.{name}" if key else name, hint, rotary)
        elif declared.role == "label":
            continue
        elif value is None:
            yield _line(f"# {name} =", _meaning(declared))
        else:
            yield _line(f"{name} = {_value_text(name, declared, value)}", _meaning(declared))
    yield from below


def _part_text(value: Any, key: str, hint: Hint, rotary: bool) -> Iterator[str]:
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


def _value_text(name: str, declared: Declaration, value: Any) -> str:
    if declared.role == "table":
        return _list([repr(float(item)) for item in value])
    if declared.role == "parameter":
        # A parameter may hold an array of variants or a symbol.
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


Choice: TypeAlias = Any  # the type of a choice: int, str, bool, float, tuple[...] or a union of them


@dataclass(frozen=True)
class Hint:
    """The type of a part: a block or section of one of `classes`, which may be families of classes.

    many      True for a list
    optional  True if it may be absent
    """

    classes: tuple[type[Any], ...]
    many: bool = False
    optional: bool = False

    def single(self) -> bool:
        """Return True if only one class matches, so that `kind` may be omitted."""
        return len(self.classes) == 1 and not inspect.isabstract(self.classes[0])


@cache
def hints(kind: type[Declared]) -> Mapping[str, Any]:
    """Return, by field name, the Hint of a part, the type of a choice, or the value type of a `named` field."""
    resolved = typing.get_type_hints(kind)
    by_name: dict[str, Any] = {}
    for name, declared in declarations(kind).items():
        if declared.role == "part":
            by_name[name] = part_hint(resolved[name])
        elif declared.role == "choice":
            by_name[name] = resolved[name]
        elif declared.role == "named":
            value = typing.get_args(options_of_type(resolved[name])[0])[1]
            by_name[name] = part_hint(value) if inspect.isclass(value) and issubclass(value, Declared) else value
    return by_name


def part_hint(annotation: Any) -> Hint:
    """Return the Hint of an annotation such as `Plant`, `Friction | None` or `tuple[Force, ...]`."""
    if typing.get_origin(annotation) is tuple:
        inner = part_hint(typing.get_args(annotation)[0])
        return Hint(inner.classes, many=True)
    if _is_union(annotation):
        inner = [part_hint(option) for option in options_of_type(annotation)]
        return Hint(
            tuple(class_ for hint in inner for class_ in hint.classes),
            many=any(hint.many for hint in inner),
            optional=types.NoneType in typing.get_args(annotation),
        )
    return Hint((annotation,))


def _is_union(annotation: Any) -> bool:
    return typing.get_origin(annotation) in (typing.Union, types.UnionType)


def options_of_type(annotation: Choice) -> tuple[Choice, ...]:
    """Return the member types of a union, excluding None, or the type itself if it is not a union."""
    if not _is_union(annotation):
        return (annotation,)
    return tuple(option for option in typing.get_args(annotation) if option is not types.NoneType)


def members(hint: Hint) -> dict[str, type[Any]]:
    """Return all classes of blocks or sections that match a hint, by kind."""
    by_kind: dict[str, type[Any]] = {}
    for family in hint.classes:
        if issubclass(family, Section):
            by_kind.update({section.kind: section for section in _members_of(family)})
            continue
        by_kind.update({family.kind: family} if not inspect.isabstract(family) else catalogue().get(family, {}))
    return by_kind


def _member(hint: Hint, kind: str) -> type[Any] | None:
    """Return the block of a kind that matches a hint of blocks, or None; the last one if several families have it, as
    in `members`.
    """
    for family in reversed(hint.classes):
        if not inspect.isabstract(family):
            if family.kind == kind:
                return family
        elif (block := member(family, kind)) is not None:
            return block
    return None


def _members_of(family: type[Section]) -> Iterator[type[Section]]:
    """Yield the leaf classes of a family of sections, or the family itself if it has no subclasses."""
    below = family.__subclasses__()
    if not below:
        yield family
    for subclass in below:
        yield from _members_of(subclass)


def choice_value(table: TomlTable, key: str, declared: Declaration, annotation: Choice, value: Any) -> Any:
    """Convert the value of a choice to its declared type. Raise ParameterError listing the allowed values."""
    held = _in_type(annotation, value)
    where = f"{table.dotted(key)} = {shown(value)} ({declared.meaning})"
    if declared.options:
        # By type as well: True equals 1, and 1.0 equals 1.
        allowed = [option for option in declared.options if type(option) is type(held) and option == held]
        if not allowed:
            listed = ", ".join(_as_text(option) for option in declared.options if option is not None)
            raise table.error(f"{where} must be one of {listed}", key)
        return allowed[0]
    if held is None:
        raise table.error(f"{where} must be {type_as_text(annotation)}", key)
    if declared.least is not None and held < declared.least:
        raise table.error(f"{where} must be >= {Quantity(declared.least):6}", key)
    if declared.most is not None and held > declared.most:
        raise table.error(f"{where} must be <= {Quantity(declared.most):6}", key)
    return held


def _as_text(option: Any) -> str:
    if isinstance(option, bool):
        return "true" if option else "false"
    return f'"{option}"' if isinstance(option, str) else str(option)


def _in_type(annotation: Choice, value: Any) -> Any:
    """Return the value if it has the given type, lists converted to tuples; otherwise None."""
    if _is_union(annotation):
        tried = (_in_type(option, value) for option in options_of_type(annotation))
        return next((converted for converted in tried if converted is not None), None)
    if typing.get_origin(annotation) is tuple:
        return _tuple_in_type(typing.get_args(annotation), value)
    # TOML distinguishes 2 from 2.0, which users do not; the reverse would hide a typing error.
    if annotation is float and type(value) is int:
        return float(value)
    return value if type(value) is annotation else None


def _tuple_in_type(inner: tuple[Any, ...], value: Any) -> tuple[Any, ...] | None:
    if not isinstance(value, list):
        return None
    expected = [inner[0]] * len(value) if inner[1:] == (Ellipsis,) else list(inner)
    if len(expected) != len(value):
        return None
    held = tuple(_in_type(type_, item) for type_, item in zip(expected, value, strict=True))
    return None if None in held else held


_TYPES = {int: "a whole number", str: 'text in quotes ("...")', bool: "true or false", float: "a number"}


def type_as_text(annotation: Choice) -> str:
    """Return a description of a type for error messages, such as `a whole number`."""
    if _is_union(annotation):
        return " or ".join(map(type_as_text, options_of_type(annotation)))
    if typing.get_origin(annotation) is tuple:
        return f"a list, each entry {type_as_text(typing.get_args(annotation)[0])}"
    return _TYPES.get(annotation, str(annotation))


B = TypeVar("B", bound=Block)
S = TypeVar("S", bound=Section)
UnitOf: TypeAlias = Callable[[TomlTable], str]
"""A function that returns, for a table, the unit of the fields declared in `VARIED`."""
_A_PROGRAM = (
    "an FMU is a program with no linear model, and nothing that a file names is executed; give the plant that it "
    "resembles, for margins and tuning, and run the FMU by  feeddrive cosimulate JOB FMU"
)


@dataclass(frozen=True)
class _Around:
    """The context in which a table is read.

    besides   keys that are read elsewhere
    unit_of   function that returns the unit of fields declared in `VARIED`
    """

    besides: frozenset[str] = field(default_factory=frozenset[str])
    unit_of: UnitOf | None = None


def read_block(family: type[B], table: TomlTable) -> B:
    """Read the block of a family from a table.

    Raises ParameterError (a key is unknown, missing, given twice, of another type, not finite or out of bounds) or
    StructureError (incompatible parts), both with file and line.
    """
    return _read(Hint((family,)), table, _Around())


def read_section(
    section: type[S], table: TomlTable, *, besides: Iterable[str] = (), unit_of: UnitOf | None = None
) -> S:
    """Read a section from a table; the family of the section selects the class.

    besides   keys that are read elsewhere
    unit_of   function that returns, for a table, the unit of fields declared in `VARIED`

    Raises the same errors as `read_block`.
    """
    return _read(Hint((section,)), table, _Around(frozenset(besides), unit_of))


def read_field(section: type[Section], table: TomlTable, name: str) -> Any:
    """Read one field of a section before the rest is read. Raises the same errors as `read_section`."""
    if name not in table.values:
        if name not in defaults(section):
            _refuse_missing(section, table, [name])
        return defaults(section)[name]
    return _value(section, table, name, name, declarations(section)[name], 1.0, _Around())


def _read(hint: Hint, table: TomlTable, around: _Around) -> Any:
    kind = _kind(hint, table)
    declared = _declared(kind, table, around)
    fields: dict[str, Any] = {}
    keys: dict[str, str] = {}
    wrong = kind.refused_alternatives(table.values) if issubclass(kind, Section) else ""
    if wrong:
        raise table.error(f"{_prefix(table)}{wrong}")
    inline = _inline(kind)
    values = {key: value for key, value in table.values.items() if key not in around.besides}
    if inline:
        # First, since it is the main content of the section, whose errors are then reported before others.
        own = {key for key in values if _is_of(key, declared, inline)}
        others = {key: value for key, value in values.items() if key not in own}
        fields[inline] = _read(hints(kind)[inline], replace(table, values=others), _Around())
        values = {key: value for key, value in values.items() if key in own}
    for key, value in values.items():
        if key == "kind" and _names_kind(kind, value):
            continue
        if issubclass(kind, Section) and kind.is_open and key not in declared:
            continue
        name, factor = _named(kind, key, table, declared)
        if name in keys:
            raise table.error(
                f"{table.dotted(name)} is given twice, as {keys[name]} and as {key}; remove one of them", key
            )
        keys[name] = key
        fields[name] = _value(kind, table, key, name, declared[name], factor, replace(around, besides=frozenset()))
    missing = [name for name in declared if name not in fields and name not in defaults(kind)]
    if missing:
        _refuse_missing(kind, table, missing)
    return _built(kind, table, fields)


def _declared(kind: type[Declared], table: TomlTable, around: _Around) -> dict[str, Declaration]:
    """Return the declarations of a class for this table: in rotary units if needed, with `VARIED` units resolved."""
    declared = {name: declaration.of_axis(table.rotary) for name, declaration in declarations(kind).items()}
    if all(declaration.unit != VARIED for declaration in declared.values()):
        return declared
    assert around.unit_of is not None, f"{kind.__name__} has a unit that its reader must be told"
    unit = around.unit_of(table)
    return {
        name: replace(declaration, unit=unit) if declaration.unit == VARIED else declaration
        for name, declaration in declared.items()
    }


def _inline(kind: type[Declared]) -> str:
    """Return the name of the section's inline part, whose keys are mixed with the section's; empty if there is none."""
    if not issubclass(kind, Section):
        return ""
    return next((name for name, declaration in declarations(kind).items() if declaration.inline), "")


def _is_of(key: str, declared: Mapping[str, Declaration], inline: str) -> bool:
    """Return True if a key belongs to the section itself and not to its inline part."""
    return any(
        key == name or (declaration.role in ("parameter", "table") and key.startswith(f"{name}_"))
        for name, declaration in declared.items()
        if name != inline
    )


def _names_kind(kind: type[Declared], value: Any) -> bool:
    """Return True if the key `kind` selects the class, rather than being one of its fields."""
    return issubclass(kind, Block) or ("kind" not in declarations(kind) and value == getattr(kind, "kind", ""))


def _value(
    kind: type[Declared], table: TomlTable, key: str, name: str, declared: Declaration, factor: float, around: _Around
) -> Any:
    """Convert the value of a key to the value of its field."""
    value = table.values[key]
    match declared.role:
        case "parameter":
            return _number(table, key, name, declared, value, factor)
        case "table":
            return _row(table, key, name, declared, value, factor)
        case "choice":
            return choice_value(table, key, declared, hints(kind)[name], value)
        case "text" | "file":
            return _text(table, key, declared, value)
        case "named":
            return _under_names(table, key, declared, hints(kind)[name], around)
        case "numbers":
            return _by_path(table, key, declared)
        case _:
            return _part(table, key, hints(kind)[name], around)


def _built(kind: type[Declared], table: TomlTable, fields: dict[str, Any]) -> Any:
    """Construct the block or section from its fields; errors raised by its checks get file and line."""
    try:
        # A value near 1e308 overflows in a check, which then refuses it.
        with np.errstate(all="ignore"):
            if not issubclass(kind, Section):
                return kind(**fields)
            section = object.__new__(kind)
            # Set before the check, whose errors name file and line.
            object.__setattr__(section, "read_from", table)
            kind.__init__(section, **fields)
            return section
    except (ParameterError, StructureError) as error:
        if issubclass(kind, Section) and str(error).startswith(table.file.name):
            raise
        raise type(error)(f"{table.where()}: {_prefix(table)}{error}") from None
    except ArithmeticError:
        called = getattr(kind, "kind", "")
        raise table.error(f"{_prefix(table)}{called} has a value too small or too large to compute with") from None


def _prefix(table: TomlTable) -> str:
    return f"{table.dotted()}: " if table.key else ""


def _kind(hint: Hint, table: TomlTable) -> type[Declared]:
    """Return the class named by `kind`, or the only matching one; a family of sections selects its own class."""
    first = hint.classes[0]
    if issubclass(first, Section):
        return first.choose(table)
    chosen = table.values.get("kind")
    if chosen is None and hint.single():
        return first
    if isinstance(chosen, str) and (known := _member(hint, chosen)) is not None:
        return known
    fitting = members(hint)
    if chosen is None:
        raise table.error(f"{_prefix(table)}kind is missing; there are: {', '.join(fitting) or 'none'}")
    # Reading a file must never execute code, and an FMU is a library of machine code.
    if chosen == "fmu":
        raise table.error(f"{table.dotted('kind')} = 'fmu': {_A_PROGRAM}", "kind")
    if isinstance(chosen, str) and RENAMED.get(chosen) in fitting:
        raise table.error(f"{table.dotted('kind')} = {shown(chosen)} is now called '{RENAMED[chosen]}'", "kind")
    raise table.error(
        f"{table.dotted('kind')} = {shown(chosen)} is not known{nearest(str(chosen), fitting)}; {OPT_IN}", "kind"
    )


def _named(kind: type[Declared], key: str, table: TomlTable, declared: Mapping[str, Declaration]) -> tuple[str, float]:
    """Return the field that a key refers to, and the conversion factor to its unit."""
    declared = {name: declaration for name, declaration in declared.items() if declaration.role != "label"}
    if key in declared:
        return key, 1.0
    wrong = ""
    # the longest name first: mass_load_kg is mass_load in kg, not mass in load_kg
    for name in sorted(declared, key=len, reverse=True):
        if not key.startswith(f"{name}_") or declared[name].role not in ("parameter", "table"):
            continue
        unit = key[len(name) + 1 :]
        try:
            return name, units.factor(unit, declared[name].unit)
        except ParameterError as error:
            wrong = wrong or f"; if {name} is meant: {error}, it is declared in '{declared[name].unit or '1'}'"
    to = f" to {kind.kind}" if issubclass(kind, Block) else ""
    raise table.error(f"key '{table.dotted(key)}' is not known{to}{wrong or nearest(key, declared)}", key)


def _number(table: TomlTable, key: str, name: str, declared: Declaration, value: Any, factor: float) -> float:
    if isinstance(value, str):
        raise table.error(
            f"{table.dotted(key)} = {shown(value)} ({declared.meaning}) must be a number without quotes; "
            f"another unit than {declared.unit or '1'} is named in the key, as in stiffness_N_per_um",
            key,
        )
    try:
        whole = isinstance(value, int | float) and not isinstance(value, bool)
        # A boolean is an int in Python: it is passed on and refused by its type.
        number = units.scaled(_float(value), factor) if whole else value
        return checked("", table.dotted(name), declared, number)
    except ParameterError as error:
        as_written = "" if key == name else f" (given as {key} = {shown(value)})"
        raise table.error(f"{error}{as_written}", key) from None


def _float(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        # A whole number of TOML may have any size; infinity is then refused by the bounds.
        return math.inf if value > 0 else -math.inf


def _row(table: TomlTable, key: str, name: str, declared: Declaration, value: Any, factor: float) -> Any:
    if not isinstance(value, list):
        raise table.error(f"{table.dotted(key)} ({declared.meaning}) must be a list of numbers: [1.0, 2.0]", key)
    row: list[float] = []
    for place, item in enumerate(value):
        if isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(_float(item)):
            entry = f"entry {place + 1} = {shown(item)}"
            raise table.error(f"{table.dotted(key)}: {entry} ({declared.meaning}) must be a finite number", key)
        row.append(units.scaled(_float(item), factor))
    try:
        return checked("", table.dotted(name), declared, row)
    except ParameterError as error:
        raise table.error(f"{error}", key) from None


def _text(table: TomlTable, key: str, declared: Declaration, value: Any) -> str:
    example = f", such as {key} = {declared.example}" if declared.example else ""
    if not isinstance(value, str):
        raise table.error(f'{table.dotted(key)} must be a text in quotes ("..."){example}', key)
    if len(value) < declared.shortest:
        raise table.error(f"{table.dotted(key)} ({declared.meaning}) must not be empty{example}", key)
    return value


def _under_names(table: TomlTable, key: str, declared: Declaration, hint: Any, around: _Around) -> dict[str, Any]:
    """Read the sections or values of a `named` field."""
    group = table.optional(key)
    assert group is not None
    if len(group.values) < declared.shortest:
        raise group.error(_too_few(group.dotted(), declared, hint))
    by_name: dict[str, Any] = {}
    for name, value in group.values.items():
        if declared.options and name not in declared.options:
            raise group.error(f"key '{group.dotted(name)}' is not known{nearest(name, declared.options)}", name)
        if declared.pattern and not re.fullmatch(declared.pattern, name):
            raise group.error(f"{group.dotted(name)}: {declared.example}", name)
        by_name[name] = (
            _part(group, name, hint, around)
            if isinstance(hint, Hint)
            else choice_value(group, name, declared=replace(declared, options=()), annotation=hint, value=value)
        )
    return by_name


def _too_few(place: str, declared: Declaration, hint: Any) -> str:
    if isinstance(hint, Hint):
        return f"there must be at least one section [{place}.NAME]"
    return f"section [{place}] is missing or empty ({declared.meaning})"


def _by_path(table: TomlTable, key: str, declared: Declaration) -> dict[str, float]:
    """Read numbers by path, given as quoted keys or nested tables."""
    group = table.optional(key)
    assert group is not None
    by_path: dict[str, float] = {}
    for path, value in _flat(group.values):
        if isinstance(value, bool) or not isinstance(value, int | float):
            remedy = f": {declared.example}" if declared.example else ""
            raise group.error(f"'{path}' must be a number in SI, not {value!r}{remedy}", path)
        by_path[path] = _float(value)
    return by_path


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _part(table: TomlTable, key: str, hint: Hint, around: _Around) -> Any:
    if hint.many:
        return tuple(_read(hint, entry, around) for entry in table.listed(key))
    value, first = table.values[key], hint.classes[0]
    if issubclass(first, Section) and first.shorthand:
        if isinstance(value, str):
            return _read(hint, replace(table, key=(*table.key, key), values={first.shorthand: value}), around)
        if not isinstance(value, dict) or not isinstance(value.get(first.shorthand), str):
            raise table.error(f"{table.dotted(key)} must be {first.wanted}", key)
    return _read(hint, table.section(key), around)


def _refuse_missing(kind: type[Declared], table: TomlTable, missing: list[str]) -> None:
    declared = {name: declarations(kind)[name].of_axis(table.rotary) for name in missing}
    if issubclass(kind, Block):
        described = ", ".join(f"{name} ({', '.join(filter(None, _described(declared[name])))})" for name in missing)
        raise table.error(f"{_prefix(table)}{kind.kind} needs {described}")
    name, first = next(iter(declared.items()))
    if first.role == "named":
        raise table.error(_too_few(table.dotted(name), first, hints(kind)[name]))
    if first.role == "part":
        raise table.error(f"section [{table.dotted(name)}] is missing ({first.meaning})")
    values = {
        table.dotted(name): ", ".join(filter(None, _described(declaration)))
        for name, declaration in declared.items()
        if declaration.role not in ("named", "part")
    }
    if len(values) > 1:
        raise table.error(f"{', '.join(f'{place} ({what})' for place, what in values.items())} are missing")
    example = f": {name} = {first.example}" if first.example else ""
    raise table.error(f"{table.dotted(name)} is missing ({values[table.dotted(name)]}){example}")


def _described(declared: Declaration) -> tuple[str, ...]:
    return "" if declared.unit == VARIED else declared.unit, declared.meaning, str(declared.bounds())
