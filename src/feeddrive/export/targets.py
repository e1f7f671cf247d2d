"""The export targets by name, with the functions that write and prove them, the manifest `export.json` and the README.

The README is rendered as plain text from a Jinja2 template in `templates/`.  An undefined name in a template is an
error.  Only `|` in a table cell is escaped, by the filter `cell`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feeddrive.analysis.stability import require_stable
from feeddrive.export.c_code import rules
from feeddrive.export.design import CONTROL, MACHINE_FILE, PLANT, Answers, Design, Trial, read_design
from feeddrive.files.atomic_io import new_directory, read_whole
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.origins import digest_of
from feeddrive.language.errors import FileError, NoSlopeError, ParameterError, nearest
from feeddrive.loop.guard import TRIPS
from feeddrive.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment


_HERE = __name__.rpartition(".")[0]
_NUMBERS = {"int | None": int, "float | None": float}


@dataclass(frozen=True)
class Proof:
    """The proof of an export: the module whose function `prove` performs it, and the length of the trial.

    samples    number of samples, for a trial that takes some seconds
    changes    number of live parameter changes in the trial; 0 if the program does not support them
    own_build  True if the export contains its own build files, so that compiler and flags cannot be chosen
    """

    module: str
    samples: int
    changes: int = 50
    own_build: bool = True

    def answers(
        self, directory: Path, design: Design, tried: Trial, flags: Sequence[str], command: str | None
    ) -> Answers:
        """Run the export in a directory and return its outputs. Raises the errors of the module's `prove`."""
        compiler = () if self.own_build else (flags, command)
        # imported on use: each target needs modules and packages that the others do not
        return import_module(f"{_HERE}.{self.module}").prove(directory, design, tried, *compiler)


@dataclass(frozen=True)
class Target:
    """An export target: the function that writes it, its capabilities, and the proof of its exports.

    options     names in `OPTIONS` that its function accepts
    precisions  supported precisions, default first
    plants      True if it can contain a plant
    together    True if it can contain the controllers of several axes as one
    fixed       arguments with which its function is always called
    velocity    True if it supports laws that command a velocity
    linear      True if it supports linear axes only, since it uses mm
    in_c        True if it contains the code of the target c, whose `broken_rule` returns the code of a violated rule
    proof       None if the export cannot run on this computer; `unproven` gives the reason
    """

    module: str
    function: str
    options: tuple[str, ...] = ()
    precisions: tuple[str, ...] = ("double",)
    plants: bool = False
    together: bool = False
    fixed: Mapping[str, Any] = field(default_factory=dict[str, Any])
    linear: bool = False
    velocity: bool = False
    in_c: bool = False
    proof: Proof | None = None
    unproven: str = ""


class TargetOption(NamedTuple):
    """An option of some targets, also offered by the command `export`.

    kind   its type in the request of the command `export`
    unit   its SI unit
    asked  its name in that request, if that name is different
    """

    kind: str
    meaning: str
    unit: str = ""
    asked: str = ""


OPTIONS: Mapping[str, TargetOption] = {
    "single_header": TargetOption("bool", "a single header", asked="header_only"),
    "joint": TargetOption("int | None", "number of the joint"),
    "route": TargetOption("str | None", "one or two pids"),
    "units": TargetOption("float | None", "machine units in a meter, 1000 for mm"),
    "core": TargetOption("str | None", "m4f, m7, or m7dp"),
    "makers": TargetOption(
        "tuple[str, ...]", "sinumerik, twincat, odrive, linuxcnc or csv; may be repeated; default: all", asked="maker"
    ),
    "lead": TargetOption("float | None", "lead of the screw, if the file has none", "m"),
    "gear": TargetOption("float | None", "turns of the motor in one of the screw"),
}
"""The options of targets, by name; each target lists those that it accepts."""

_BOTH = ("double", "float")
TARGETS: dict[str, Target] = {
    "c": Target(
        "c_bundle",
        "write_c",
        ("single_header",),
        _BOTH,
        plants=True,
        together=True,
        velocity=True,
        in_c=True,
        proof=Proof("c_bundle", 1_000_000, own_build=False),
    ),
    "linuxcnc": Target(
        "linuxcnc",
        "write_linuxcnc",
        ("joint",),
        together=True,
        linear=True,
        in_c=True,
        proof=Proof("linuxcnc_session", 50_000, changes=0),
    ),
    "linuxcnc-pid": Target(
        "linuxcnc_pid",
        "write_linuxcnc_pid",
        ("joint", "route", "units"),
        linear=True,
        unproven="is numbers for LinuxCNC's own pid, which computes something else; see its README",
    ),
    "fmu2": Target(
        "fmu",
        "write_fmu",
        plants=True,
        together=True,
        fixed={"version": 2},
        in_c=True,
        proof=Proof("fmu", 50_000),
    ),
    "fmu3": Target(
        "fmu",
        "write_fmu",
        plants=True,
        together=True,
        fixed={"version": 3},
        in_c=True,
        proof=Proof("fmu", 50_000),
    ),
    "cortex-m": Target(
        "cortex_m",
        "write_cortex_m",
        ("core",),
        ("float", "double"),
        together=True,
        in_c=True,
        proof=Proof("cortex_m", 2_000, changes=8),
    ),
    "st": Target(
        "structured_text",
        "write_structured_text",
        precisions=_BOTH,
        together=True,
        velocity=True,
        unproven="runs on a PLC: {name}_check.st, in the same directory, makes the same comparison there",
    ),
    "parameters": Target(
        "parameters",
        "write_parameters",
        ("makers", "lead", "gear"),
        unproven="is numbers for a person to check; there is nothing to run",
    ),
}


def write_export(
    source: MachineLike,
    target: str,
    out: str | Path | None = None,
    *,
    axis: str | None = None,
    name: str | None = None,
    precision: str | None = None,
    plant: bool = False,
    together: bool = False,
    **options: Any,
) -> tuple[Design, Path]:
    """Export the controller of an axis, or with `plant` the axis itself, to a target; return the design and the README.

    source     a machine file, or the name of a bundled machine; `axis` is required if it has several axes
    plant      export the plant; without an `axis`, all axes of the file with their couplings as one plant
    target     a name in `TARGETS`
    out        directory, written atomically; default: results/export_MACHINE_AXIS_TARGET
    name       prefix of all names on the target; default: `axis_x`, or `plant_x`
    precision  "double" or "float", if the target supports both
    options    options of the target, by name in `OPTIONS`

    Raises ParameterError for an unknown target or an option of another target, UnstableError for a loop that is
    unstable with the axis of its machine file, and the errors of `read_design` and of the target's function.
    """
    design, place, write = _planned(source, target, out, axis, name, precision, plant, together, options)
    return design, write(design, place)


def write_all(
    source: MachineLike,
    target: str,
    out: str | Path | None = None,
    *,
    axis: str | None = None,
    name: str | None = None,
    precision: str | None = None,
    plant: bool = False,
    together: bool = False,
    **options: Any,
) -> list[tuple[Design, Path]]:
    """Export as `write_export` does; without an `axis`, export the controllers of all axes of the file.

    With `together`, or if the controllers are coupled, all of them form one design.  Otherwise each has a separate
    directory `out`/AXIS and, with a `name`, the prefix NAME_AXIS.  All designs are checked before the first is written.
    """
    machine = read_machine(source)
    axes = list(machine.loops)
    together = together or (axis is None and not plant and any(coupling.controls for coupling in machine.couplings))
    if axis is not None or plant or together or len(axes) == 1:
        return [
            write_export(
                source,
                target,
                out,
                axis=axis,
                name=name,
                precision=precision,
                plant=plant,
                together=together,
                **options,
            )
        ]
    if options.get("joint") is not None:
        raise ParameterError("--joint belongs to one axis: name the axis by --axis, or leave both out")
    planned = []
    for i, own in enumerate(axes):
        place = None if out is None else Path(out) / own
        if "joint" in _chosen(target).options:
            options["joint"] = i
        prefix = None if name is None else f"{name}_{own}"
        planned.append(_planned(source, target, place, own, prefix, precision, False, False, options))
    return [(design, write(design, place)) for design, place, write in planned]


def write_again(design: Design, target: str, out: Path, options: Mapping[str, Any]) -> None:
    """Repeat an export with the options of its `export.json`; the same design gives identical files.

    Raises the errors of the target's function, and TypeError for options that it does not accept.
    """
    chosen = _chosen(target)
    write = getattr(import_module(f"{_HERE}.{chosen.module}"), chosen.function)
    write(design, out, **{**options, **chosen.fixed})


def _planned(
    source: MachineLike,
    target: str,
    out: str | Path | None,
    axis: str | None,
    name: str | None,
    precision: str | None,
    plant: bool,
    together: bool,
    options: Mapping[str, Any],
) -> tuple[Design, Path, Callable[[Design, Path], Path]]:
    """Return the checked design, the path of its export, and the function that writes it."""
    chosen = _chosen(target)
    # the command passes every option: one that was not given must not count as foreign to the target
    chosen_options = {key: value for key, value in options.items() if value not in (None, False, ())}
    for option in chosen_options:
        if option not in chosen.options:
            raise ParameterError(f"{_flag(option)} means nothing for the target {target}{_instead(option)}")
    for option, declared in OPTIONS.items():
        value, kind = chosen_options.get(option), _NUMBERS.get(declared.kind)
        # bool first: Python counts True and False as whole numbers
        if kind is not None and value is not None and (isinstance(value, bool) or not isinstance(value, int | kind)):
            wanted = "a whole number" if kind is int else "a number"
            raise ParameterError(f"{_flag(option)} = {value!r} must be {wanted}")
    if plant and not chosen.plants:
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if entry.plants)
        raise ParameterError(f"--plant means nothing for the target {target}; an axis can be exported to {fits}")
    if together and (axis is not None or plant):
        raise ParameterError("--together is for the controls of all axes: leave out --axis and --plant")
    if together and not chosen.together:
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if entry.together)
        raise ParameterError(
            f"--target = '{target}' holds the control of one axis; the controls of several axes as one, as a contour "
            f"control between them needs it, can be exported to {fits}"
        )
    if precision is not None and precision not in chosen.precisions:
        raise ParameterError(f"--precision = '{precision}': the target {target} has {', '.join(chosen.precisions)}")
    what = PLANT if plant else CONTROL
    design = read_design(
        source, axis, name=name, what=what, precision=precision or chosen.precisions[0], together=together
    )
    if "velocity" in {loop.axis.actuator.commanded for loop in design.system.loops().values()}:
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if entry.velocity)
        if plant or not chosen.velocity:
            given = "--plant" if plant else f"--target = '{target}'"
            raise ParameterError(
                f"{given}: the drive of axis {design.axis} is commanded by "
                f"velocities, and this is written for axes that take a force; the control can be exported to {fits}"
            )
    if chosen.linear and any(loop.axis.rotary for loop in design.system.loops().values()):
        fits = ", ".join(target_ for target_, entry in TARGETS.items() if not entry.linear)
        raise ParameterError(
            f"--target = '{target}': axis {design.axis} turns, and this target is written for axes that move along, in "
            f"mm or with a lead; {fits} are in rad and N m"
        )
    if not plant:
        # a law without a linear model is exported all the same: the remarks state that nothing is proven
        with suppress(NoSlopeError):
            require_stable(design.system)
    stem, part = Path(design.machine.file.name).stem, "all" if design.together else design.axis
    place = Path("results") / f"export_{stem}_{part}_{target}" if out is None else Path(out)
    write = getattr(import_module(f"{_HERE}.{chosen.module}"), chosen.function)
    return design, place, partial(write, **chosen.fixed, **chosen_options)


def _chosen(target: str) -> Target:
    if target not in TARGETS:
        raise ParameterError(f"--target = '{target}' is not a target{nearest(target, TARGETS)}")
    return TARGETS[target]


def _flag(option: str) -> str:
    """Return an option in its command-line spelling."""
    asked = OPTIONS[option].asked if option in OPTIONS else ""
    return f"--{(asked or option).replace('_', '-')}"


def _instead(option: str) -> str:
    fits = [name for name, entry in TARGETS.items() if option in entry.options]
    return f"; it belongs to {', '.join(fits)}" if fits else ""


FILE = "export.json"
NEW = ".new"  # behind the name of a file whose older edit was kept
MOST_BYTES = 10_000_000  # of a file


@dataclass(frozen=True)
class Manifest:
    """The content of `export.json`: `source` is the name of the machine file, `files` maps names to SHA-256 digests."""

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
        "files": {name: digest_of(content) for name, content in sorted(files.items())},
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def write_bundle(design: Design, target: str, out: Path, files: Mapping[str, bytes | str], **options: Any) -> Path:
    """Write an export atomically: `files`, the machine file and `export.json`; return the path of the README.

    A file of an older export that was edited (its digest differs from `export.json`) is kept, and the new file is
    written as NAME`.new`; `edits_kept` lists these files.

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
    """Return the contents of the files to write: the new ones, and the edited ones of the older export."""
    contents = dict(files)
    for name in changed_files(out, read_manifest(out)):
        if not (out / name).is_file():
            continue
        edit = read_whole(out / name, MOST_BYTES)
        if name in files and digest_of(files[name]) != digest_of(edit):
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
    """Return the files of an export that are missing or modified. Raises FileError for a name outside the export."""
    wrong = []
    for name, digest in manifest.files.items():
        file = directory / name
        # an `export.json` may come from anybody: its names must not lead out of the directory
        if not Path(os.path.abspath(file)).is_relative_to(os.path.abspath(directory)):
            raise FileError(f"{directory / FILE}: names the file '{name}' outside the export: export again")
        if file.is_symlink() or not file.is_file() or digest_of(read_whole(file, MOST_BYTES)) != digest:
            wrong.append(name)
    return wrong


def _text(value: Any) -> str:
    # TypeError, which `read_manifest` reports as a malformed file
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not a text")
    return value


def readme(template: str, design: Design, **content: Any) -> str:
    """Return the README of a design in Markdown. It is deterministic: the same content gives the same text.

    template  a file of `templates/`; besides `content` it receives `design`, `routine`, `P` (the prefix of all names),
              `title`, `made_by`, `control` (True for a controller, False for an axis), `trips` and `c_rules`
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
    """Return a string escaped for a cell of a Markdown table."""
    return text.replace("|", "\\|")
