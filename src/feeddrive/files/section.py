"""Sections: the schema of a table in a user's file, as a frozen dataclass of declared fields.

    class LogSection(Section):
        \"\"\"A measured log, whose reference is replayed.\"\"\"
        file: str | None = file_name("name of the log, beside the job", default=None)
        skip_samples: int = choice("samples at the start that do not count", least=0, default=0)
        sample_time: Number | None = parameter("s", "of a log without a column of time", above=0, default=None)

The reader (`from_toml.py`), the JSON Schema (`schema.py`) and the reference pages of the keys use the declarations.
Sections have the fields of blocks (`language/block.py`): `parameter`, `choice`, `table`, `part`, and in addition
    text()      a free text
    file_name() the name of a file
    named()     sections or values by a name: `[axis.x]`, `[axis.y]`
    numbers()   numbers by the path of a parameter, written in quotes or as nested tables
A part is a block, a section, or a tuple of them (`[[law]]`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass
from types import MappingProxyType
from typing import Any, ClassVar, dataclass_transform

from feeddrive.files.toml_file import Key, TomlTable
from feeddrive.language.block import (
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
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError

VARIED = "*"
"""Unit of a field whose unit follows from the content of its section, as that of a parameter that varies."""
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
    """Declare a dict of numbers in SI by path; `example` is the hint shown for a value of another type."""
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
    exactly    mutually exclusive alternatives, one of which is required; each is a tuple of fields, any of which counts
    needs      error sentence for a section with none or several of the alternatives
    shorthand  field that is set if the section is given as a plain text
    wanted     accepted values of a section with a shorthand, for messages
    needs_kind True if the key `kind` is required, since another class of the family is the default
    inlined    field, and the section whose keys appear directly in this one if the field is absent
    is_open    True if undeclared keys belong to other readers and are ignored
    read_from  the table that it was read from
    """

    kind: ClassVar[str] = ""
    exactly: ClassVar[tuple[tuple[str, ...], ...]] = ()
    needs: ClassVar[str] = ""
    shorthand: ClassVar[str] = ""
    wanted: ClassVar[str] = ""
    needs_kind: ClassVar[bool] = False
    inlined: ClassVar[Mapping[str, type[Section]]] = MappingProxyType({})
    is_open: ClassVar[bool] = False
    read_from: ClassVar[TomlTable | None] = None  # of an object the table; not a field, since it is no content

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
        """Return the error sentence if not exactly one alternative is among `names`; empty if the names are valid."""
        first = [next((name for name in fields if name in names), None) for fields in cls.exactly]
        there = [name for name in first if name is not None]
        if not cls.exactly or len(there) == 1:
            return ""
        written = " and ".join(f"[{name}]" if "[" in cls.needs else name for name in there)
        return f"{cls.needs}, not {written}" if there else cls.needs

    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        if declaration.role in ROLES_OF_SECTIONS or value is defaults(type(self)).get(name, MISSING):
            return value
        return checked(self.kind, name, declaration, value)

    def error(self, message: str, name: str | Key = (), kind: type[FeeddriveError] = ParameterError) -> FeeddriveError:
        """Return an error for this section or a key in it, with file and line if it was read from a file."""
        return kind(message) if self.read_from is None else self.read_from.error(message, name, kind)

    def dotted(self, name: str = "") -> str:
        """Return the dotted name of the section or of a key in it: `law.2.name`."""
        return name if self.read_from is None else self.read_from.dotted(name or ())
