"""A request: a frozen dataclass of declared fields, from which command-line options and forms are generated.

    class ExciteRequest(Request):
        machine: str = argument("A machine file (TOML), or the name of a bundled machine")
        amplitude: float = option("peak of the excitation", unit="N", above=0)
        max_compliance: float | None = option("largest compliance", unit="m/N", entered="um/N", above=0)

Each field declares its meaning, SI unit, bounds, options and default once.  It is validated when the request is
created, with the same error message as a block parameter.  `entered` is the unit used on the command line and in forms;
the request itself holds SI values.
"""

import dataclasses
import inspect
import shlex
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any, Literal, dataclass_transform

from feeddrive.language import units
from feeddrive.language.block import Declaration, Declared, check_bounds, check_choice
from feeddrive.language.errors import ParameterError

OUT = "Directory to write; one that feeddrive wrote before is replaced"
OUT_FILE = "File to write"
CHANNELS = "mapping of columns to roles (TOML), as `feeddrive channels` writes it"
UNIT = "unit of columns that state none, as mm, in or kN; may be repeated"


@dataclass(frozen=True)
class Field:
    """A field of a request.

    kind      the type of one value: str, Path, int, float or bool
    kinds     all types that Python may pass instead: the path of a log, or a `Log`
    many      True if the field is a tuple of such values
    unit      the SI unit in the request; `declared.unit` is the unit in which users enter the value
    flag      on the command line; empty for a positional argument
    """

    name: str
    kind: type
    kinds: tuple[type, ...]
    many: bool
    default: Any
    unit: str
    declared: Declaration
    flag: str
    short: str

    @property
    def required(self) -> bool:
        """True if the field has no default."""
        return self.default is MISSING

    @property
    def factor(self) -> float:
        """The conversion factor from the entered unit to SI."""
        return units.factor(self.declared.unit, self.unit) if self.declared.unit != self.unit else 1.0

    def help(self) -> str:
        """Return meaning, options and unit as a help text."""
        meaning = self.declared.meaning
        options = [str(choice) for choice in self.declared.options]
        named = f": {', '.join(options[:-1])} or {options[-1]}" if options else ""
        here = self.declared.unit
        turned = here if self.name == "lead" or here.endswith("/A") else units.turning(here)  # a screw's, a motor's
        unit = f" ({here}; {turned} of an axis that turns)" if turned != here else f" ({here})" if here else ""
        return f"{meaning[:1].upper()}{meaning[1:]}{named}{unit}."

    def shown(self, value: Any) -> str:
        """Return one value in the form of the command line: a number in the entered unit."""
        if self.kind is float:
            return units.shortest(value, self.factor)
        return str(value) if self.kind is int else called(value)

    def checked(self, value: Any) -> Any:
        """Return the validated value. Raise ParameterError with name, value, bound and unit."""
        if value is None and self.default is None:
            return None
        if self.many:
            values: Any = (value,) if isinstance(value, (str, Path)) else value
            return tuple(self._one(item) for item in values)
        return self._one(value)

    def _one(self, value: Any) -> Any:
        where = self.flag or self.name
        if self.kind is Path and isinstance(value, str):
            return Path(value)
        if self.kind is not float and (
            not isinstance(value, self.kinds) or isinstance(value, bool) != (self.kind is bool)
        ):
            names = [kind.__name__ for kind in self.kinds]
            known: dict[type, str] = {int: "a whole number", bool: "True or False"}
            wanted = known.get(self.kind, f"a {' or '.join(names)}")
            shown = f" = {value!r}" if isinstance(value, str | int | float) else ""
            hint = f", not a {type(value).__name__}: {getattr(value, 'instead', '')}" if not shown else ""
            raise ParameterError(f"{where}{shown} ({self.declared.meaning}) must be {wanted}{hint}".rstrip(": "))
        if self.kind is float:
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ParameterError(f"{where} ({self.declared.meaning}) must be a number, not {value!r}")
            check_bounds(where, self.declared, float(value) / self.factor)
            return float(value)
        if self.kind in (str, int):
            check_choice(where, self.declared, value)
        return value


def argument(
    meaning: str, *, default: Any = MISSING, options: tuple[str, ...] = (), kw_only: Literal[False] = False
) -> Any:
    """Declare a positional argument of the command line: the file or machine of the command."""
    declared = Declaration(role="argument", unit="", meaning=meaning, options=options)
    metadata = {"declaration": declared, "unit": "", "short": "", "flag": ""}
    return dataclasses.field(default=default, kw_only=kw_only, metadata=metadata)


def option(
    meaning: str,
    *,
    default: Any = MISSING,
    unit: str = "",
    entered: str = "",
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    options: tuple[str, ...] = (),
    flag: str = "",
    short: str = "",
    last: bool = False,
    kw_only: Literal[True] = True,
) -> Any:
    """Declare an option, required without a default. `last`: it is listed after the options of subclasses."""
    declared = Declaration(
        role="option",
        unit=entered or unit,
        meaning=meaning,
        above=above,
        least=least,
        below=below,
        most=most,
        options=options,
    )
    metadata = {"declaration": declared, "unit": unit, "short": short, "flag": flag, "last": last}
    return dataclasses.field(default=default, kw_only=kw_only, metadata=metadata)


@dataclass_transform(frozen_default=True, field_specifiers=(argument, option))
class Request(Declared):
    """The base class of all requests. Subclasses become frozen dataclasses that validate themselves."""

    def __init_subclass__(cls, more: Mapping[str, tuple[str, Any]] | None = None, after: str = "") -> None:
        """Create a request class; `more` has further options (annotation and `option(...)`), inserted after a field."""
        if more:
            hints = dict(cls.__annotations__)
            place = list(hints).index(after) + 1
            names = [*list(hints)[:place], *more, *list(hints)[place:]]
            hints |= {name: annotation for name, (annotation, _) in more.items()}
            cls.__annotations__ = {name: hints[name] for name in names}
            for name, (_, field) in more.items():
                setattr(cls, name, field)
        dataclass(frozen=True)(cls)

    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        return _by_name(type(self))[name].checked(value)

    def command_line(self, name: str) -> str:
        """Return the equivalent command line."""
        words = ["feeddrive", name]
        for field in fields_of(type(self)):
            value = getattr(self, field.name)
            if value == field.default or value in (None, ()):
                continue
            values: tuple[Any, ...] = value if field.many else (value,)
            for item in values:
                shown = field.shown(item)
                words += ([field.flag] if field.flag else []) + ([] if field.kind is bool else [shown])
        return shlex.join(words)

    def python(self, name: str) -> str:
        """Return the equivalent Python call, after `import feeddrive as fd`."""
        pairs = [(field, getattr(self, field.name)) for field in fields_of(type(self))]
        words = [
            f"{'' if not field.flag else f'{field.name}='}{_literal(value)}"
            for field, value in pairs
            if value != field.default
        ]
        return f"fd.workflow.{name.replace('-', '_')}({', '.join(words)})"

    def usual_out(self) -> Path | None:
        """Return the default output path of a command; None for a command without one."""
        return None


@cache
def fields_of(request: type[Request]) -> tuple[Field, ...]:
    """Return the fields of a request in order; fields declared with `last` follow all others."""
    hints = typing.get_type_hints(request)
    fields: list[Field] = []
    specs = dataclasses.fields(request)  # type: ignore[arg-type]
    for spec in sorted(specs, key=lambda spec: spec.metadata.get("last", False)):
        kinds, many = _kind(hints[spec.name])
        metadata = spec.metadata
        declared = metadata["declaration"]
        positional = declared.role == "argument"
        flag = "" if positional else metadata["flag"] or f"--{spec.name.replace('_', '-')}"
        fields.append(
            Field(spec.name, kinds[0], kinds, many, spec.default, metadata["unit"], declared, flag, metadata["short"])
        )
    return tuple(fields)


@cache
def _by_name(request: type[Request]) -> dict[str, Field]:
    return {field.name: field for field in fields_of(request)}


def called(source: Any) -> str:
    """Return the display name of a source: its file, its name or its type; "none given" for None."""
    if source is None:
        return "none given"
    if isinstance(source, str | Path):
        return str(source)
    file = getattr(source, "file", None)
    if file is not None:
        return str(file.name)
    return str(getattr(source, "name", "") or type(source).__name__)


def stem(source: Any) -> str:
    """Return the display name without folder and suffix, for the names of results."""
    return Path(called(source)).stem


def told_apart(named: Iterable[tuple[str, str]]) -> list[str]:
    """Make names unique by appending the given word to repeated ones."""
    unique = list[str]()
    for name, word in named:
        tries = chain([name, f"{name} ({word})"], (f"{name} ({word}, {i})" for i in count(2)))
        unique.append(next(candidate for candidate in tries if candidate not in unique))
    return unique


def _literal(value: Any) -> str:
    """Return a value as a Python literal; a path as its text, an object by its display name."""
    if isinstance(value, tuple):
        inside: tuple[Any, ...] = value
        return f"({', '.join(map(_literal, inside))}{',' if len(inside) == 1 else ''})"
    known = value is None or isinstance(value, str | int | float)
    return repr(value) if known else repr(called(value))


def _kind(hint: Any) -> tuple[tuple[type, ...], bool]:
    """Return the types of a union, and True if they are in a tuple: `tuple[Path, ...]`, `str | MachineFile`."""
    kinds = typing.get_args(hint) if typing.get_origin(hint) in (types.UnionType, typing.Union) else (hint,)
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    if typing.get_origin(kinds[0]) is tuple:
        return _kind(typing.get_args(kinds[0])[0])[0], True
    return kinds, False


def frequencies(band: str) -> tuple[float, float]:
    """Parse a band of frequencies such as `5..500` into two numbers in Hz. Raise ParameterError."""
    parts = band.split("..")
    try:
        low, high = (float(part) for part in parts)
    except ValueError:
        raise ParameterError(f"band '{band}' must be two frequencies in Hz, as 5..500") from None
    return low, high


def signature(request: Callable[..., Any], work: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a command: the request's fields as parameters, the outcome's result as return type."""
    result = str(work.__annotations__["return"]).removeprefix("Outcome[").removesuffix("]")
    declared = inspect.signature(request)
    parameters = [declared.parameters[field.name] for field in fields_of(request)]  # type: ignore[arg-type]
    return declared.replace(parameters=parameters, return_annotation=result)
