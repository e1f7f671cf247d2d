"""A command: a function with a declared request, a protocol for progress and cancellation, and a printable outcome.

The same object is called from Python, where `fd.tune("ball_screw", goal="stiffness")` returns the result, and by the
command line and the studio, which show the outcome.  In place of a file name, a command also accepts
the object that it would read from the file.

`COMMANDS` lists the module, one-line description, group and examples of every command, so that `--help` need not import
the modules.  `fd.workflow.NAME` is the command (with _ for -).

A request is a frozen dataclass of declared fields, from which command-line options and forms are generated:

    class ExciteRequest(Request):
        machine: str = argument("A machine file (TOML), or the name of a bundled machine")
        amplitude: float = option("peak of the excitation", unit="N", above=0)
        max_compliance: float | None = option("largest compliance", unit="m/N", entered="um/N", above=0)

Each field declares its meaning, SI unit, bounds, options and default once.  It is validated when the request is
created, with the same error message as a block parameter.  `entered` is the unit used on the command line and in forms;
the request itself holds SI values.
"""

from __future__ import annotations

import dataclasses
import inspect
import shlex
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass
from functools import cache
from importlib import import_module
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, ParamSpec, TypeVar, dataclass_transform

from feeddrive.language import units
from feeddrive.language.block import Declaration, Declared, check_bounds, check_choice
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest, sentence
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Units
from feeddrive.language.table import Grid, Result, Table
from feeddrive.language.text import Text, resolve

if TYPE_CHECKING:
    from feeddrive.report.report import Report


OUT = "Directory to write; one that feeddrive wrote before is replaced"
OUT_FILE = "File to write"
CHANNELS = "mapping of columns to roles (TOML), as `feeddrive channels` writes it"
UNIT = "unit of columns that state none, as mm, in or kN; may be repeated"


@dataclass(frozen=True)
class Field:
    """A field of a request.

    kind      the type of one value on the command line: str, Path, int, float or bool
    kinds     all types accepted in Python, such as the path of a log, or a `Log`
    many      True if the field is a tuple of such values
    unit      the SI unit in the request; `declared.unit` is the unit in which users enter the value
    flag      the option on the command line; empty for a positional argument
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
        """Return the help text: meaning, options and unit."""
        meaning = self.declared.meaning
        options = [str(choice) for choice in self.declared.options]
        named = f": {', '.join(options[:-1])} or {options[-1]}" if options else ""
        here = self.declared.unit
        # the lead of a screw stays in m and the constant of a motor per A, also for an axis that turns
        turned = here if self.name == "lead" or here.endswith("/A") else units.turning(here)
        unit = f" ({here}; {turned} of an axis that turns)" if turned != here else f" ({here})" if here else ""
        return f"{meaning[:1].upper()}{meaning[1:]}{named}{unit}."

    def shown(self, value: Any) -> str:
        """Return one value as text for the command line; a float is converted to the unit in which users enter it."""
        if self.kind is float:
            return units.shortest(value, self.factor)
        return str(value) if self.kind is int else called(value)

    def checked(self, value: Any) -> Any:
        """Return the validated value. Raise ParameterError, with name, value, bound and unit, if it is invalid."""
        if value is None and self.default is None:
            return None
        if self.many:
            values: Any = (value,) if isinstance(value, (str, *self.kinds)) else value
            return tuple(self._one(item) for item in values)
        return self._one(value)

    def _one(self, value: Any) -> Any:
        where = self.flag or self.name
        if self.kind is Path and isinstance(value, str):
            return Path(value)
        # bool is a subclass of int: True must not pass as a whole number
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
            # bounds are declared in the unit in which users enter the value
            check_bounds(where, self.declared, float(value) / self.factor)
            return float(value)
        if self.kind in (str, int):
            check_choice(where, self.declared, value)
        return value


BOX = (
    "tolerances of the plant within which the limits hold: stiffness=0.2,mass=0.3,dead_time=1sample (that is "
    "standard), identified (standard, and two standard errors where the machine file has them), auto (identified if it "
    "has them, else standard), or none"
)
"""The meaning of the option `--box` of all commands that have it; its text is read by `MachineFile.box`."""

AT_THE_MODEL = (
    "The limits hold at the model only, and need not where masses, stiffnesses or the dead time differ: --box standard "
    "makes them hold there too, --box identified within the errors of an identification."
)
"""The note of commands whose limits hold over no box."""

OF_ERRORS = (
    "The box holds the standard errors of an identification, and not what its model leaves out: for another workpiece "
    "take --box standard; a mode of the axis is shown by a frequency response (feeddrive excite, frf)."
)
"""The note of commands whose limits hold over the box `identified`."""


def argument(
    meaning: str, *, default: Any = MISSING, options: tuple[str, ...] = (), kw_only: Literal[False] = False
) -> Any:
    """Declare a positional argument of the command line: the main input of a command, such as a file or machine."""
    declared = Declaration(role="argument", unit="", meaning=meaning, options=options)
    # type checkers read `kw_only` from the signature of a field specifier (PEP 681), so it must be a parameter
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
    """Declare an option, required unless it has a default. With `last` it is listed after the options of subclasses."""
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
    """The base class of all requests. Subclasses become frozen dataclasses that validate their fields."""

    def __init_subclass__(cls, more: Mapping[str, tuple[str, Any]] | None = None, after: str = "") -> None:
        """Create a request class. `more` lists options (annotation and `option(...)`) to insert after field `after`."""
        if more:
            hints = dict(cls.__annotations__)
            place = list(hints).index(after) + 1
            names = [*list(hints)[:place], *more, *list(hints)[place:]]
            hints |= {name: annotation for name, (annotation, _) in more.items()}
            # dataclass takes the order of the fields from the annotations
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
        """Return the equivalent Python call; it assumes `import feeddrive as fd`."""
        pairs = [(field, getattr(self, field.name)) for field in fields_of(type(self))]
        words = [
            f"{'' if not field.flag else f'{field.name}='}{_literal(_alone(field, value))}"
            for field, value in pairs
            if value != field.default
        ]
        return f"fd.workflow.{name.replace('-', '_')}({', '.join(words)})"

    def usual_out(self) -> Path | None:
        """Return the default output path of the command line; None if the command has none."""
        return None


@cache
def fields_of(request: type[Request]) -> tuple[Field, ...]:
    """Return the fields of a request in order; fields declared with `last` follow all others."""
    # under postponed evaluation the annotations are texts until they are resolved here
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


def line(command: str, *words: object, axis: str | None = None) -> str:
    """Return a command line of feeddrive, quoted for a shell, with the option `--axis` if an axis is given."""
    return shlex.join(("feeddrive", command, *map(str, words), *(("--axis", axis) if axis else ())))


# limits that a new guard is shown with; each machine has its own
GUARD_LIMITS = "following_error_limit=0.001,velocity_limit=1"


def exporting(machine: str | Path, axis: str | None, *, guarded: bool) -> tuple[str, tuple[str, ...]]:
    """Return the next command line on the way from a machine file to its export, and notes on it.

    Only a control with a guard can be exported; if there is no guard, the command line adds one.
    """
    if guarded:
        return line("export", machine, "-t", "c", axis=axis), ()
    added = line("adjust", machine, "--guard", GUARD_LIMITS, "--out", machine, axis=axis)
    return added, (
        "The control has no guard, without which it is not exported: put the limits of your machine in place of "
        f"{GUARD_LIMITS}.",
    )


def called(source: Any) -> str:
    """Return the display name of a source: its file, name or type; "none given" for None."""
    if source is None:
        return "none given"
    if isinstance(source, str | Path):
        return str(source)
    file = getattr(source, "file", None)
    if file is not None:
        return str(file.name)
    return str(getattr(source, "name", "") or type(source).__name__)


def stem(source: Any) -> str:
    """Return the display name of a source without folder and suffix, for use in the names of results."""
    return Path(called(source)).stem


def told_apart(named: Iterable[tuple[str, str]]) -> list[str]:
    """Return the names of (name, word) pairs, made unique by appending the word, then a number, to a repeated name."""
    unique = list[str]()
    for name, word in named:
        tries = chain([name, f"{name} ({word})"], (f"{name} ({word}, {i})" for i in count(2)))
        unique.append(next(candidate for candidate in tries if candidate not in unique))
    return unique


def _alone(field: Field, value: Any) -> Any:
    """Return the value of a field, or its only item: in Python one log needs no tuple."""
    return value[0] if field.many and not field.flag and len(value) == 1 else value


def _literal(value: Any) -> str:
    """Return the Python literal of a value; a path becomes a string, any other object its display name."""
    if isinstance(value, tuple):
        inside: tuple[Any, ...] = value
        return f"({', '.join(map(_literal, inside))}{',' if len(inside) == 1 else ''})"
    known = value is None or isinstance(value, str | int | float)
    return repr(value) if known else repr(called(value))


def _kind(hint: Any) -> tuple[tuple[type, ...], bool]:
    """Return the types that an annotation allows, except None, and True for a tuple such as `tuple[Path, ...]`."""
    # `A | B` of classes is a UnionType, but a typing.Union as soon as one side is an alias or a type parameter
    kinds = typing.get_args(hint) if typing.get_origin(hint) in (types.UnionType, typing.Union) else (hint,)
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    if typing.get_origin(kinds[0]) is tuple:
        return _kind(typing.get_args(kinds[0])[0])[0], True
    return kinds, False


def frequencies(band: str) -> tuple[float, float]:
    """Parse a frequency band such as `5..500` into two numbers in Hz. Raise ParameterError if it is not a band."""
    parts = band.split("..")
    try:
        low, high = (float(part) for part in parts)
    except ValueError:
        raise ParameterError(f"band '{band}' must be two frequencies in Hz, as 5..500") from None
    return low, high


def signature(request: Callable[..., Any], work: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a command: the request's fields as parameters, the outcome's result as return type."""
    # the text of the annotation suffices: resolving it would need an import of the result's module
    result = str(work.__annotations__["return"]).removeprefix("Outcome[").removesuffix("]")
    declared = inspect.signature(request)
    parameters = [declared.parameters[field.name] for field in fields_of(request)]  # type: ignore[arg-type]
    return declared.replace(parameters=parameters, return_annotation=result)


P = ParamSpec("P")
R = TypeVar("R", bound=Request)
T = TypeVar("T")

_MODELS = ("machine", "source", "controller", "baseline", "job")  # fields that may name a machine file or a job


@dataclass(frozen=True, repr=False)
class Outcome(Generic[T]):
    """The outcome of a command.

    result    the result object, which a call in Python returns
    tables    tables to show first, with sentences between them
    remarks   important remarks on the result
    verdict   one sentence with the recommendation or the finding
    notes     consequences of the verdict
    section   section to paste into a TOML file
    files     paths of the written files, by kind
    details   tables and sentences that reports always contain, and the terminal shows with --verbose, after the remarks
    rotary    True for a rotary axis, which is shown in rad, N m and kg m2; the result may declare this instead
    judgment  the judgment of the command on its result, which determines the exit code
    failure   the reason for a negative judgment, if the verdict does not state it
    error     the error that ended the command early, if partial results are worth keeping
    page      the function that builds the command's own report, if there is one; it must be picklable
    then      the suggested next command line, with the paths of this outcome; empty if there is none
    """

    result: T
    tables: Sequence[Table | str] = ()
    remarks: Sequence[str] = ()
    verdict: str = ""
    notes: Sequence[str] = ()
    section: str = ""
    files: Mapping[str, str | Path] = dataclasses.field(default_factory=dict[str, str | Path])
    details: Sequence[Table | str] = ()
    rotary: bool = False
    judgment: Judgment = Judgment.DONE
    failure: str = ""
    error: FeeddriveError | None = None
    page: Callable[[], Report] | None = None
    then: str = ""

    def __post_init__(self) -> None:
        for name in ("tables", "remarks", "notes", "details"):
            # a Text keeps its quantities as numbers, which an axis that turns shows in other units
            shown = tuple(Text(item) if isinstance(item, str) else item for item in getattr(self, name))
            object.__setattr__(self, name, shown)
        for name in ("verdict", "failure"):
            object.__setattr__(self, name, Text(getattr(self, name)))

    @property
    def turns(self) -> bool:
        """True if the outcome is about a rotary axis."""
        return self.rotary or bool(getattr(self.result, "rotary", False))

    def contents(self, *, verbose: bool = True) -> Iterator[Table | str]:
        """Yield the tables and sentences of the result, in order; without the details unless `verbose`."""
        yield from self.tables
        yield from (Text(f"- {remark}") for remark in self.remarks)
        if verbose:
            yield from (detail if isinstance(detail, Table) else Text(f"- {detail}") for detail in self.details)
        elif self.details:
            yield f"- {len(self.details)} more with --verbose"
        if self.verdict:
            yield self.verdict
        yield from (Text(f"- {note}") for note in self.notes)

    def shown(self, units: Units | None = None, *, verbose: bool = True) -> Iterator[Grid | str]:
        """Yield the tables and sentences of the result as shown to the user, in order and in the display units."""
        units = units or self.units
        for item in self.contents(verbose=verbose):
            yield item.grid(units) if isinstance(item, Table) else resolve(item, units)

    @property
    def units(self) -> Units:
        """The units of the outcome, rotary for a rotary axis."""
        return Units(rotary=self.turns)

    def written(self) -> Iterator[str]:
        """Yield the section to paste, the paths of the files that were written, and the suggested next command."""
        if self.section:
            yield ""
            yield self.section
        yield from (f"{what}: {path}" for what, path in self.files.items())
        if self.then:
            yield f"Next: {self.then}"

    def report(self) -> Report:
        """Return the report: that of `page`, or a general one made from the outcome. No output directory is needed."""
        return self._told() if self.page is None else self.page()

    def _told(self) -> Report:
        """Return a general report of the outcome: verdict, picture if the result has one, tables, remarks, details."""
        # imported on use: most outcomes are printed and never become a report
        from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict

        result: Any = self.result
        titles = [table.title for table in self.tables if isinstance(table, Table)]
        title = titles[0] if titles else type(result).__name__
        drawn = None
        if isinstance(result, Result) and result.has_picture():
            drawn = Picture("result", title, "", f"The picture of: {title}.", result.chart)
        return Report(
            title,
            "feeddrive",
            Verdict((self.verdict or sentence(self.judgment.says), self.failure), good=not self.judgment.bad),
            (
                Section("result", "Result", (*self.tables, Remarks(self.remarks), Remarks(self.notes, "What follows"))),
                Section("details", "Details", self.details, folded=True),
            ),
            drawn,
            self.turns,
        )

    def record(self, command: str = "") -> dict[str, Any]:
        """Return the outcome as data for JSON: tables in SI with units and errors, sentences, files and judgment.

        command  the name of the command, repeated in the data
        """
        units, error = self.units, self.error
        code = self.judgment.exit_code if error is None else error.exit_code
        return {
            "command": command,
            "judgment": self.judgment.name.lower(),
            "exit_code": code,
            **_recorded(self.tables, units),
            "remarks": [_told(remark, units) for remark in self.remarks],
            "verdict": _told(self.verdict, units),
            "notes": [_told(note, units) for note in self.notes],
            "failure": _told(self.failure, units),
            "section": self.section,
            "files": {what: str(path) for what, path in self.files.items()},
            "next": self.then,
            "details": _recorded(self.details, units),
            "error": None if error is None else failure(error),
        }

    def __repr__(self) -> str:
        return "\n".join(map(str, (*self.shown(), *self.written())))


def failure(error: Exception) -> dict[str, str]:
    """Return the class name and the message of an error as data for JSON."""
    return {"kind": type(error).__name__, "message": str(error)}


def _recorded(shown: Sequence[Table | str], units: Units) -> dict[str, list[Any]]:
    """Return tables and the sentences between them as data for JSON."""
    return {
        "tables": [item.record(units) for item in shown if isinstance(item, Table)],
        "texts": [_told(item, units) for item in shown if not isinstance(item, Table)],
    }


def _told(text: str, units: Units) -> str:
    return str(resolve(text, units))


class Command(Generic[P, R, T]):
    """A function that takes a request and a `Progress`, and that can also be called with the request's fields.

    Nothing is written unless the field `out` of the request is set.
    """

    def __init__(self, request: Callable[P, R], work: Callable[[R, Progress], Outcome[T]]) -> None:
        self.request, self.work = request, work
        # help() and inspect then show the command's function and not this class
        self.__doc__, self.__name__, self.__module__ = work.__doc__, work.__name__, work.__module__
        self.__signature__ = signature(request, work)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """Run the command and return its result, not the outcome. `progress` may be passed as an additional keyword; in
        a notebook the default shows a line under the cell.
        """
        from feeddrive.workflow.notebook import cell_progress  # not for the command line

        progress: Any = kwargs.pop("progress", None)
        with cell_progress() as shown:
            outcome = self.run(self.build_request(*args, **kwargs), progress or shown)
        if outcome.error is not None:
            raise outcome.error
        return outcome.result

    def build_request(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Build the request. Raise ParameterError for an invalid field, in rotary units for a rotary axis."""
        try:
            # bound first, so that a wrong name is reported in the words of the command and not by a TypeError of a
            # dataclass
            bound = inspect.signature(self.request).bind(*args, **kwargs)
        except TypeError as error:
            raise ParameterError(self._misuse(kwargs, str(error))) from None
        try:
            return self.request(*args, **kwargs)
        except FeeddriveError as error:
            if _turns(bound.arguments):
                _worded(error)
            raise

    def _misuse(self, arguments: Mapping[str, Any], message: str) -> str:
        fields = {declared.name: declared for declared in fields_of(self.request)}  # type: ignore[arg-type]
        wrong = [name for name in arguments if name not in fields]
        if wrong:
            return f"{self.__name__} has no option '{wrong[0]}'{nearest(wrong[0], fields)}"
        needed = ", ".join(
            f"{name} ({declared.declared.meaning})" for name, declared in fields.items() if declared.required
        )
        return f"{self.__name__}: {message}; it needs {needed or 'nothing'}, all else by name"

    def run(self, request: R, progress: Progress | None = None) -> Outcome[T]:
        """Run the request. Raise FileError at the start if the output directory is not writable."""
        for declared in fields_of(type(request)):
            place = getattr(request, declared.name)
            # only options with the meaning OUT name a directory; a single file is checked when it is written
            if declared.declared.meaning == OUT and place is not None:
                # imported on use: a request without an output directory needs no file access
                from feeddrive.files.atomic_io import check_directory

                check_directory(place)
        try:
            outcome = self.work(request, progress or Progress())
        except FeeddriveError as error:
            # the files are read for this once more, so only if it makes a difference
            if _rotary(error) != resolve(f"{error}", Units()) and _turns(vars(request)):
                _worded(error)
            raise
        if outcome.turns and outcome.error is not None:
            _worded(outcome.error)
        return outcome


def _worded(error: FeeddriveError) -> None:
    """Convert the units in an error message to those of a rotary axis."""
    error.args = (_rotary(error), *error.args[1:])


def _rotary(error: FeeddriveError) -> str:
    """Return an error message in the units of a rotary axis."""
    return resolve(f"{error}", Units(rotary=True))


def _turns(fields: Mapping[str, Any]) -> bool:
    """Return True if all axes of a request are rotary, as far as its machine files and jobs can be read."""
    # imported on use: only an error needs to know whether the axes turn
    from feeddrive.files.job import Job, read_job
    from feeddrive.files.machine import MachineFile, read_machine
    from feeddrive.loop.loop import Loop

    loops = list[Loop]()
    for name, value in fields.items():
        for read in (read_machine, read_job) if isinstance(value, str | Path) and name in _MODELS else ():
            # a file that cannot be read has its own error elsewhere; here it only leaves the question open
            with suppress(FeeddriveError):
                value = read(value)
                break
        value = value.machine if isinstance(value, Job) else value
        if isinstance(value, MachineFile):
            axis = str(fields.get("axis", ""))
            # an error about one axis uses its units; without a named axis all axes must agree
            loops += [value.loops[axis]] if axis in value.loops else list(value.loops.values())
        elif isinstance(value, Loop):
            loops.append(value)
    return bool(loops) and all(loop.axis.rotary for loop in loops)


def command(request: Callable[P, R]) -> Callable[[Callable[[R, Progress], Outcome[T]]], Command[P, R, T]]:
    """Return a decorator that turns a function into a command: `@command(TuneRequest)`."""
    return lambda work: Command(request, work)


class Listed(NamedTuple):
    """An entry in `--help`: the module of a command, its one-line description, its group, and example arguments."""

    module: str
    summary: str
    group: str
    examples: tuple[str, ...]


COMMANDS: dict[str, Listed] = {
    "channels": Listed(
        "channels",
        "Guess which column of a log is what, and write it as a short TOML to correct and give with --channels.",
        "Measure",
        ("run.csv --out roles.toml",),
    ),
    "force": Listed(
        "force",
        "Find the factor from percent, A, V or pid.output to N or N m by data sheets; print the line that says so.",
        "Measure",
        ("percent --column trq --rated 3.2:Nm --lead 0.01",),
    ),
    "excite": Listed(
        "excite",
        "Design a multisine, check travel, speed and force by simulation, and write it to be sent to the drive.",
        "Measure",
        ("ball_screw --band 5..1000 --amplitude 400 --out sent",),
    ),
    "play": Listed(
        "play",
        "Move an axis: play an excitation on a drive over EtherCAT or CANopen, within limits, and log what it did.",
        "Measure",
        ("sent/excitation_1.csv --drive drive.toml --share 0.1",),
    ),
    "listen": Listed(
        "play",
        "Log a drive over its bus without switching it on.",
        "Measure",
        ("--drive drive.toml --seconds 2",),
    ),
    "commission": Listed(
        "commission",
        "Take a drive from unknown to a proven loop that runs: sign, mass, responses, tuning, export and a trial.",
        "Measure",
        ("drive.toml --out axis_x", "--virtual ball_screw --yes --out axis_x"),
    ),
    "follow": Listed(
        "follow",
        "Wait for a trigger in a log that is being written, a pipe or a drive on a bus, and keep the window around it.",
        "Measure",
        ("run.csv --channel force --level 100", "drive.toml --window 2"),
    ),
    "frf": Listed(
        "frf",
        "Estimate a frequency response with coherence, variance, noise and distortion from measured logs.",
        "Measure",
        ("run_1.csv run_2.csv --channels roles.toml --out response",),
    ),
    "identify": Listed(
        "identify",
        "Find mass, friction and dead time in one log or several, or masses and modes in frequency responses.",
        "Model",
        (
            "log.csv --machine emps",
            "monday.csv tuesday.csv wednesday.csv --mass 95",
            "frf.csv --motor reading_motor --load reading_load --machine mine.toml",
        ),
    ),
    "friction": Listed(
        "friction",
        "Find the friction curve in runs of constant speed: models compared by evidence, parameters with errors.",
        "Model",
        ("runs.csv --velocity v:mm/s --force f:N",),
    ),
    "cogging": Listed(
        "cogging",
        "Find the cogging of a motor in slow runs: its orders, with errors, and what changes sign with the direction.",
        "Model",
        ("slow.csv --position x:mm --current iq:A --period 24:mm --force-constant 40",),
    ),
    "tune": Listed(
        "tune",
        "Tune gains and filters of an axis within limits; write a machine file and a report before against after.",
        "Tune and compare",
        (
            "ball_screw --goal stiffness",
            "response/frf.csv --law cascade_ppi --sample-time 1e-3",
            "--study ball_screw_series --out robust",
        ),
    ),
    "travel": Listed(
        "travel",
        "Tune a law over the travel: gains at each position, interpolated in the step; limits kept between them.",
        "Tune and compare",
        ("near.toml middle.toml far.toml --position 400 --position 1500 --position 2700 --out schedule.toml",),
    ),
    "adjust": Listed(
        "adjust",
        "Set named numbers of a control within their bounds; all else in the machine file stays as it is written.",
        "Tune and compare",
        ("ball_screw --set law.Kp=52000 --set filters.0.frequency=430 --out mine.toml",),
    ),
    "compare": Listed(
        "compare",
        "Put all laws on one axis, tuned to equal robustness, beside today's gains, and rank them by criterion.",
        "Tune and compare",
        ("tuned/machine.toml --keep started",),
    ),
    "benchmark": Listed(
        "benchmark",
        "Run every law on the fixed plants of the benchmark with its stored design, and print the table to be cited.",
        "Tune and compare",
        ("--verbose", "--plant rack --law DADSC", "--retune --law LADRC --keep designs"),
    ),
    "new": Listed(
        "new",
        "Make a package for a law of your own: its file, a test with the battery, a machine file to try it on.",
        "Tune and compare",
        ("law smith_law",),
    ),
    "prefilter": Listed(
        "learn",
        "Fit the prefilter that cancels what a loop leaves of its tracking error, from one log.",
        "Tune and compare",
        ("run.csv --out prefilter.toml",),
    ),
    "setpath": Listed(
        "setpath",
        "Correct a part program before it runs: friction by its plan, or by the log of the last part; judged on a box.",
        "Tune and compare",
        (
            "circle_diamond_square --law P-PI --out part",
            "job.toml --from-log part.csv --last part --out next_part",
            "linear_motor --method splines --out path.csv",
        ),
    ),
    "iterate": Listed(
        "learn",
        "Learn mass, viscous and dry friction to feed forward from the error of a trial: a log, or simulated ones.",
        "Tune and compare",
        ("run.csv --controller xy_table --axis x --out next.toml",),
    ),
    "plan": Listed(
        "plan",
        "Plan a part program within velocity, acceleration, jerk and snap of each axis: setpoints with a proof.",
        "Plan",
        ("part.ngc --machine xy_table --out plan",),
    ),
    "run": Listed(
        "run_job",
        "Run the laws of a job over the same work and write a report, a summary and the signals.",
        "Simulate",
        ("job.toml",),
    ),
    "sweep": Listed(
        "sweep",
        "Run many variants of a job, as a study says, on all cores; what is done is kept, and --resume goes on.",
        "Simulate",
        ("ball_screw_series --out series", "study.toml --workers 8 --out series --resume"),
    ),
    "lobes": Listed(
        "lobes",
        "Find the depths of a milling cut without chatter over the spindle speed; say whether this machine's cut does.",
        "Simulate",
        ("mine.toml --speeds 2000:12000:200 --mode 922:0.011:0.04",),
    ),
    "demo": Listed(
        "run_job",
        "Run a bundled example: a real ball-screw axis under today's control and three better ones; a mill at work.",
        "Simulate",
        ("--out demo", "mill --out demo_mill"),
    ),
    "tour": Listed(
        "tour",
        "Simulate the log of the first tour: the bundled ball screw with a workpiece, more friction, noise and counts.",
        "Simulate",
        ("--out tour",),
    ),
    "reproduce": Listed(
        "reproduce",
        "Run a paper's experiments and write what it claims, by which rule, and what came out; 1 if a claim fails.",
        "Simulate",
        ("gordon2013",),
    ),
    "circle": Listed(
        "circle",
        "Circular test after ISO 230-4 with its causes: from logs of x and y, or on a simulated machine.",
        "Simulate",
        ("ccw.csv cw.csv --x x:mm --y y:mm --out circles", "xy_table --radius 20"),
    ),
    "cosimulate": Listed(
        "run_job",
        "Run the laws of a job against somebody else's model of the machine: an FMU in place of the plant.",
        "Simulate",
        ("job.toml press.fmu --variable force=motor.F --variable reading=table.x:mm",),
    ),
    "virtual-drive": Listed(
        "play",
        "Be a CiA 402 drive with the plant and the control of a machine file inside, until Ctrl-C.",
        "Simulate",
        ("ball_screw --interface veth1 --drive-file drive.toml",),
    ),
    "certify": Listed(
        "certify",
        "Prove a loop, as it will run, stable for plants with a disc around each; write a certificate and a report.",
        "Prove and deploy",
        ("tuned/machine.toml --measured frf.csv",),
    ),
    "check": Listed(
        "check",
        "Check a certificate in exact arithmetic: 0 if it is proven, 1 with the reason if refused.",
        "Prove and deploy",
        ("tuned/certificate.json",),
    ),
    "export": Listed(
        "export",
        "Write the control of an axis for a target: what is written computes what was simulated, bit for bit.",
        "Prove and deploy",
        ("tuned/machine.toml --axis x --target c --out axis_x",),
    ),
    "verify": Listed(
        "export",
        "Run the equality proof of an export again, with this machine's compiler; 1 if anything differs.",
        "Prove and deploy",
        ("axis_x",),
    ),
    "doctor": Listed(
        "doctor",
        "Say what feeddrive needs on this computer, what of it is there, and what to type for the rest.",
        "This computer",
        ("",),
    ),
}


def load(name: str) -> Command[Any, Any, Any]:
    """Return the command with this name."""
    return getattr(import_module(f"feeddrive.workflow.{COMMANDS[name].module}"), name.replace("-", "_"))
