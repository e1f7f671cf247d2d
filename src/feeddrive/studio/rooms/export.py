"""The Export page of the studio: machine file, report and code, and all steps as commands, Python and a job.

The commands repeat the steps without the page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from feeddrive.export.targets import TARGETS, write_export
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import quoted
from feeddrive.language import units
from feeddrive.language.block import declarations, defaults
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.guard import Guard
from feeddrive.studio.desk import Asked, Desk, Held, Room, Said, act, free_name
from feeddrive.studio.jobs import perform
from feeddrive.studio.works import Shown, exported, packed, reported
from feeddrive.tuning.filters import difference
from feeddrive.workflow.adjust import AdjustRequest
from feeddrive.workflow.export import ExportRequest, VerifyRequest

# the numbers of a guard that do nothing unless a person enters them: bounds that are absent, and a force of 0
_BOUNDS = tuple(
    name for name, declared in declarations(Guard).items() if declared.role == "parameter" and not defaults(Guard)[name]
)


_EXAMPLE, _LINES = "ball_screw", 20


@dataclass(frozen=True)
class Recipe:
    """The steps on the page as commands, as a script and as a job.

    commands  shell commands, one per line
    python    Python script
    job       job file that simulates the move of the page with reference and current controller; empty if there is no
              machine
    """

    commands: str
    python: str
    job: str


def recipe_of(desk: Desk) -> Recipe:
    """Return the recipe of the steps on the page in order, including parameters that were changed manually."""
    steps = [(step.command, step.request) for step in desk.done]
    moved = None if desk.bench is None or desk.bench.machine is None else desk.not_yet_done()
    if moved is not None:
        steps.append(("adjust", moved))
    commands = [request.command_line(name) for name, request in steps]
    kept = [
        f"# {path}: {what}; keep this file"
        for path, what in desk.kept.items()
        if any(str(path) in step for step in commands)
    ]
    commands = [*kept, *commands]
    python = ["import feeddrive as fd", "", *kept]
    python += [request.python(name) for name, request in steps]
    return Recipe("\n".join([*commands, ""]), "\n".join([*python, ""]), _job(desk))


def _job(desk: Desk) -> str:
    """Return a job that compares the reference and current controllers under the same move and force."""
    bench = desk.bench
    if bench is None or bench.machine is None:
        return ""
    move, force, duration = bench.work
    lines = [
        f"title = {quoted(f'{bench.title}: before and after')}",
        f"machine = {quoted(whole(bench.file))}",
        f"axis = {quoted(bench.axis)}",
        f"duration = {duration!r}",
        "",
        to_toml(move, "reference", rotary=bench.rotary).strip(),
        "",
        to_toml(force, "load", rotary=bench.rotary).strip(),
        "",
    ]
    return "\n".join([*lines, *law_lines(desk, "by hand")])


def law_lines(desk: Desk, name: str) -> list[str]:
    """Return the lines of a job with the current controller as a row of its own; none if it is that of the machine."""
    bench = desk.needed
    before, now = bench.before.start, desk.control
    # both controls run with the guard of the machine file, which a job keeps unless it states one
    changes = difference(before, replace(now, guard=before.guard))
    if changes is not None and changes.is_empty:
        return []
    if changes is not None and not changes.removed and not changes.added:
        pairs = ", ".join(
            f"{quoted(f'axis.{bench.axis}.control.{key}')} = {value!r}" for key, value in changes.values.items()
        )
        return ["[[law]]", f"name = {quoted(name)}", f"set = {{ {pairs} }}", ""]
    text = to_toml(replace(now, guard=None), "law.control", rotary=bench.rotary).strip()
    return ["[[law]]", f"name = {quoted(name)}", "", text, ""]


def whole(machine: str | Path) -> str:
    """Return a reference to a machine that is valid in any directory: a bundled name, or an absolute path."""
    path = Path(machine)
    return str(path.resolve()) if path.exists() else str(machine)


@cache
def _example() -> str:
    """Return the first lines of exported C code that compute the law of a bundled axis."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / _EXAMPLE
        write_export(_EXAMPLE, "c", out)
        lines = (out / "axis_x.c").read_text(encoding="utf-8").splitlines()
    begin = max(number for number, line in enumerate(lines) if "/* control.law" in line)
    return "\n".join(lines[begin : begin + _LINES])


class Export(Room):
    """The page for the export of tuned and proven results."""

    name = "export"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Discard the exports of the previous controller."""
        self.exports: dict[str, tuple[Held, Shown]] = {}
        self.verified: dict[str, Mapping[str, Any]] = {}

    def show(self) -> Said:
        """Return the available exports and the recipe."""
        bench = self.desk.bench
        recipe = recipe_of(self.desk)
        words = {
            "ready": bench is not None and bench.machine is not None,
            "targets": list(TARGETS),
            "of": _EXAMPLE.replace("_", " "),
            "example": "" if bench is not None and bench.machine is not None else _example(),
            "results": [{"name": name, "said": remark} for name, remark in self.desk.results().items()],
            "exports": {name: self.desk.said_of(held, shown.words) for name, (held, shown) in self.exports.items()},
            "verified": self.verified,
            "bounds": self._bounds(),
            "commands": recipe.commands,
            "python": recipe.python,
            "job_file": recipe.job,
        }
        return Said(words)

    @act
    def machine(self, _: Asked) -> Said:
        """Export the machine file with the current controller."""
        return self._give(self.desk.write_machine())

    @act
    def result(self, asked: Asked) -> Said:
        """Export the directory of a result, with its report, as an archive."""
        return self._give(packed(self.desk.folder / asked.choice("name", self.desk.results())))

    @act
    def recipe(self, asked: Asked) -> Said:
        """Export the recipe as a file: commands, Python or job."""
        steps = recipe_of(self.desk)
        texts = {
            "commands": ("commands.sh", steps.commands),
            "python": ("recipe.py", steps.python),
            "job": ("before_and_after.toml", steps.job),
        }
        name, text = texts[asked.choice("kind", texts)]
        if not text:
            raise ParameterError("a job needs a machine: measured responses alone move no axis")
        path = self.desk.folder / name
        write_whole(path, text)
        return self._give(path)

    @act
    def guard(self, asked: Asked) -> None:
        """Add a guard to the controller, with the trip limits that were entered in the fields of `_bounds`."""
        bench = self.desk.needed
        bench.needed_loop()
        self.desk.check_free()
        bounds = dict[str, float]()
        for bound in self._bounds():
            value = asked.number_or_none(bound["name"])
            if value is not None:
                bounds[bound["name"]] = value * bound["factor"]
        # the safe force acts only after a trip, for which a guard needs a bound
        if not bounds.keys() - {"safe_force"}:
            raise ParameterError("a guard needs a bound: give the largest following error or the largest velocity")
        text = ",".join(f"{name}={value!r}" for name, value in bounds.items())
        path = free_name(self.desk.folder, "guarded.toml")
        request = AdjustRequest(self.desk.machine_path(), guard=text, axis=bench.axis, out=path)
        # no job: an edit of a file takes milliseconds
        result = perform("adjust", request, Progress()).result
        self.desk.did("adjust", request)
        self.desk.exchange(result.loop(bench.axis).control, path)

    def _bounds(self) -> list[dict[str, Any]]:
        """Return the fields of a guard for a controller without one; exports other than parameters need a guard."""
        bench = self.desk.bench
        if bench is None or bench.loop is None or self.desk.control.guard is not None:
            return []
        rows = list[dict[str, Any]]()
        for name in _BOUNDS:
            declared = declarations(Guard)[name].of_axis(bench.rotary)
            unit = "mm" if declared.unit == "m" else declared.unit
            factor = units.factor(unit, declared.unit) if unit != declared.unit else 1.0
            rows.append({"name": name, "meaning": declared.meaning, "unit": unit, "factor": factor})
        return rows

    @act
    def export(self, asked: Asked) -> None:
        """Export the current controller for a target."""
        bench, target = self.desk.needed, asked.choice("target", TARGETS)
        bench.needed_loop()
        out = self.desk.folder / f"export_{target}"
        request = ExportRequest(self.desk.machine_path(), target=target, axis=bench.axis, out=out)
        held = self.desk.held()

        def then(shown: Shown) -> None:
            self.desk.did("export", request)
            self.exports[target] = held, shown
            # the proof belonged to the previous export
            self.verified.pop(target, None)

        self.desk.start(self.name, f"export for {target}", partial(exported, request), then)

    @act
    def verify(self, asked: Asked) -> None:
        """Verify again, with this computer's compiler, that exported code and simulation give identical results."""
        target = asked.choice("target", self.exports)
        request = VerifyRequest(self.desk.folder / f"export_{target}")

        def then(verified: Shown) -> None:
            self.desk.did("verify", request)
            self.verified[target] = verified.words

        self.desk.start(self.name, f"verify the export for {target}", partial(reported, "verify", request), then)

    def _give(self, path: Path) -> Said:
        return Said({**self.show().words, "give": path.name})
