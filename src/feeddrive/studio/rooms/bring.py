"""Files are brought: what each was understood to be, which column is what, and what is made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive.files.columns import ROLES, Column
from feeddrive.files.frf import read_frfs, write_frf
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.studio.bench import bench_of, bench_of_responses
from feeddrive.studio.desk import Desk, free_name
from feeddrive.studio.inspect_file import LOG, MACHINE, PROGRAM, RESPONSES, Understood, understand
from feeddrive.studio.room import Asked, Room, Said, act, tabled
from feeddrive.studio.uploads import safe_name, stem_of
from feeddrive.studio.works import Shown, fitted, toured
from feeddrive.workflow.frf import FrfRequest
from feeddrive.workflow.identify_responses import IdentifyRequest
from feeddrive.workflow.tour import MACHINE as MACHINE_OF_TOUR
from feeddrive.workflow.tour import TourRequest
from feeddrive.workflow.tune_sources import LOAD, MOTOR

_ROLES, _CHOSEN = "roles of columns, as the page had them", "responses that were chosen on the page"


class Bring(Room):
    """What is worked on."""

    name = "bring"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.files: dict[str, Understood] = {}
        self.open = ""  # the file that is shown
        self.made: Shown | None = None  # the last identification
        self._made_of = ""  # the file that it was about
        self.machine: Path | None = None  # that it wrote
        self.start_from = ""  # the machine that is chosen before a person chooses one
        self._began = False

    def show(self) -> Said:
        """Bundled machines, the files, and the columns of the one that is open."""
        if self.desk.brought and not self._began:
            self._began = True
            self._read([each.name for each in self.desk.brought])
        words: dict[str, Any] = {
            "bundled": _bundled(),
            "files": [self._file(each) for each in self.files.values()],
            "open": self.open,
            "made": {},
            "roles": dict(ROLES),
            "start_from": self.start_from,
            "offers_tour": not self.files and self.desk.bench is None,
        }
        charts = dict[str, Chart]()
        found = self.files.get(self.open)
        if found is not None and found.guess is not None:
            words["columns"] = self._columns(found)
            charts["columns"] = _preview(found)
        if self.made is not None:
            words["made"] = {**self.made.words, "of": self._made_of, "machine": self.machine is not None}
            charts |= self.made.charts
        return Said(words, charts)

    @act
    def look(self, asked: Asked) -> None:
        """Read files that were brought, and say what they are."""
        names = asked.texts("names")
        if not names:
            raise ParameterError("no file is named: choose one, or drop it on the page")
        self._read(names)

    @act
    def pick(self, asked: Asked) -> None:
        """Show a file."""
        self.open = self._known(asked).name

    @act
    def drop(self, asked: Asked) -> None:
        """Forget a file."""
        found = self._known(asked)
        del self.files[found.name]
        self.desk.files.pop(found.name, None)
        self.desk.programs.pop(found.name, None)
        self.open = "" if self.open == found.name else self.open

    @act
    def bundled(self, asked: Asked) -> Said:
        """Work on a bundled machine."""
        return self._put(asked.choice("name", _bundled()), asked)

    @act
    def tour(self, _: Asked) -> None:
        """Simulate the log of the tour and bring it; the machine file to start from is that of its control."""
        out = self.desk.folder / "tour"
        request = TourRequest(out=out)

        def then(found: list[Understood]) -> None:
            self.desk.did("tour", request)
            self.start_from = MACHINE_OF_TOUR
            for each in found:
                self._show(each, each.name, out / each.name)

        self.desk.start(self.name, "simulate the log of the tour", partial(toured, request), then)

    @act
    def axis(self, asked: Asked) -> Said:
        """Work on an axis of a machine file that was brought; `at`: the same at other positions."""
        found = self._known(asked)
        if found.kind != MACHINE:
            raise ParameterError(f"{found.name} is no machine file but: {found.kind}")
        return self._put(self._path(found.name), asked)

    @act
    def role(self, asked: Asked) -> None:
        """A column gets a role, with a unit or a factor; an empty role takes it away."""
        found = self._known(asked)
        guess, column = found.guess, asked.text("column")
        known = set[str]() if guess is None else {*found.columns, *(each.name for each in guess.mapping.values())}
        if guess is None or column not in known:
            raise ParameterError(f"{found.name} has no column {column!r:.60}{nearest(column, known)}")
        role = asked.choice("role", ["", *ROLES])
        columns = {key: each for key, each in guess.mapping.items() if each.name != column and key != role}
        reasons = {key: guess.mapping.reasons.get(key, "") for key in columns}
        if role:
            columns[role], reasons[role] = self._column(asked, column), "chosen"
        mapping = replace(guess.mapping, columns=columns, reasons=reasons)
        self.files[found.name] = replace(found, guess=replace(guess, mapping=mapping))

    @act
    def identify(self, asked: Asked) -> None:
        """Find masses, friction and dead time, or modes; a machine file is written where the law is known."""
        found = self._known(asked)
        path, out = self._path(found.name), self._free(f"identified_{stem_of(found.name)}")
        unit = asked.text_or_none("unit")
        request = IdentifyRequest(
            path,
            channels=self._roles(found) if found.kind == LOG else None,
            out=out,
            machine=self._machine(asked),
            axis=asked.text_or_none("axis"),
            motor=asked.text_or_none("motor"),
            load=asked.text_or_none("load"),
            lead=asked.number_or_none("lead"),
            force_constant=asked.number_or_none("force_constant"),
            sample_time=asked.number_or_none("sample_time"),
            law=asked.text_or_none("law"),
            unit=() if unit is None else (unit,),
        )
        self._start("identify", found.name, f"identify {found.name}", request)

    @act
    def estimate(self, asked: Asked) -> None:
        """Frequency responses from logs of one measurement."""
        found = self._known(asked)
        if found.kind != LOG:
            raise ParameterError(f"{found.name} is no log but: {found.kind}")
        names = [each.name for each in self.files.values() if each.kind == LOG and each.name != found.name]
        more = [self._path(each) for each in names if asked.yes("all")]
        out = self._free(f"frf_{stem_of(found.name)}")
        logs = (self._path(found.name), *more)
        request = FrfRequest(
            logs, channels=self._roles(found), out=out, sample_time=asked.number_or_none("sample_time")
        )
        self._start("frf", found.name, f"estimate responses from {found.name}", request)

    @act
    def responses(self, asked: Asked) -> Said:
        """Work on measured responses, without a machine or beside today's."""
        found = self._known(asked)
        if found.kind != RESPONSES:
            raise ParameterError(f"{found.name} holds no frequency responses")
        places = [self._path(each) for each in asked.texts("at")]
        bench = bench_of_responses(
            self._chosen(found, asked),
            at=places,
            baseline=self._machine(asked),
            axis=asked.text_or_none("axis"),
            unit=asked.text_or_none("unit"),
            sample_time=asked.number_or_none("sample_time"),
            delay=asked.number_or_none("delay") or 0.0,
        )
        self.desk.put(bench)
        return self._on("tune")

    @act
    def take(self, _: Asked) -> Said:
        """Work on the machine file that the identification wrote."""
        if self.machine is None:
            raise ParameterError("no machine file was identified yet")
        friction = None if self.made is None else self.made.friction
        self.desk.put(replace(bench_of(self.machine), friction=friction))
        return self._on("tune")

    def _put(self, machine: str | Path, asked: Asked) -> Said:
        axis = asked.text_or_none("axis")
        at = [self._path(each) for each in asked.texts("at")]
        file = read_machine(machine)
        if axis is None and len(file.loops) > 1:
            return Said({**self.show().words, "ask_axis": {"name": asked.text("name"), "axes": list(file.loops)}})
        self.desk.put(bench_of(machine, axis, at=at))
        return self._on("tune")

    def _chosen(self, found: Understood, asked: Asked) -> Path:
        """The file, or one with the responses that were chosen of a file with several."""
        path, load = self._path(found.name), asked.text_or_none("load")
        if load is None:
            return path
        there = read_frfs(path)
        chosen = [replace(there[asked.choice("load", there)], output=LOAD[0])]
        if asked.text_or_none("motor") is not None:
            chosen.append(replace(there[asked.choice("motor", there)], output=MOTOR[0]))
        kept = free_name(self.desk.folder, f"chosen_{stem_of(found.name)}.csv")
        write_frf(kept, *chosen)
        self.desk.kept[kept] = _CHOSEN
        return kept

    def _machine(self, asked: Asked) -> str | Path | None:
        """The machine that is named: one that was brought, or a bundled one."""
        name = asked.text_or_none("machine")
        if name is None:
            return None
        return self._path(name) if name in self.files else asked.choice("machine", _bundled())

    def _on(self, room: str) -> Said:
        said = self.show()
        return Said({**said.words, "go": room}, said.charts)

    def _read(self, names: Sequence[str]) -> None:
        what = f"read {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        paths = {name: self._path(name) for name in names}

        def then(found: list[Understood]) -> None:
            for (name, path), each in zip(paths.items(), found, strict=True):
                self._show(each, name, path)

        self.desk.start(self.name, what, partial(understand, [*paths.values()]), then)

    def _start(self, command: str, name: str, what: str, request: Any) -> None:
        def then(found: Shown) -> None:
            self.desk.did(command, request)
            self._made_of = name
            self._finished(found)

        self.desk.start(self.name, what, partial(fitted, command, request), then)

    def _finished(self, found: Shown) -> None:
        places = found.files
        self.machine = next((path for path in places.values() if path.name == "machine.toml"), None)
        responses = [path for path in places.values() if path.suffix in (".csv", ".parquet") and path.is_file()]
        self.made = found
        for path, each in zip(responses, understand(responses, Progress()), strict=True):
            # what was estimated is a file like one that was brought, by the name of its directory: all are frf.csv
            self._show(each, path.parent.name + path.suffix, path)

    def _show(self, found: Understood, name: str, path: Path) -> None:
        """A file is shown under a name, in place of one that had it before."""
        self.files[name], self.desk.files[name], self.open = replace(found, name=name), path, name
        self.desk.programs.pop(name, None)
        if found.kind == PROGRAM:
            self.desk.programs[name] = path

    def _free(self, name: str) -> Path:
        """A path for what is made: no file that was made before is replaced, since an undo may go back to it."""
        return free_name(self.desk.folder, name)

    def _known(self, asked: Asked) -> Understood:
        name = asked.text("name")
        if name not in self.files:
            raise ParameterError(f"no file {name!r:.80} was brought{nearest(name, self.files)}")
        return self.files[name]

    def _path(self, name: str) -> Path:
        """Where a file that was brought, made or named at the start stands."""
        path = self.desk.files.get(safe_name(name))
        if path is None or not path.is_file() or path.is_symlink():
            raise ParameterError(f"no file {name!r:.80} was brought")
        return path

    def _roles(self, found: Understood) -> Path:
        assert found.guess is not None
        self.desk.check_free()
        text = found.guess.toml(self._path(found.name))
        return self.desk.keep(f"roles_{stem_of(found.name)}.toml", text.encode(), _ROLES)

    @staticmethod
    def _column(asked: Asked, name: str) -> Column:
        """A column with the unit and the factor that were typed."""
        return Column(name=name, unit=asked.text_or_none("unit") or "", factor=asked.number_or_none("factor"))

    def _columns(self, found: Understood) -> list[dict[str, Any]]:
        """Each column with its role, unit and reason; then what needs a factor."""
        assert found.guess is not None
        roles = {each.name: (role, each) for role, each in found.guess.mapping.items()}
        needs = {name: (role, what) for role, (name, what) in found.guess.needs.items()}
        shown = list[dict[str, Any]]()
        for name in dict.fromkeys([*roles, *needs, *found.columns]):
            role, column = roles.get(name, ("", None))
            why = found.guess.mapping.reasons.get(role, "") if role else found.guess.unused.get(name, "")
            if name in needs and not role:
                why = f"may be {needs[name][0]}: needs a factor, {needs[name][1]}"
            shown.append(
                {
                    "column": name,
                    "role": role,
                    "unit": "" if column is None else column.unit,
                    "factor": None if column is None else column.factor,
                    "stated": found.units.get(name, ""),
                    "why": why,
                }
            )
        return shown

    @staticmethod
    def _file(found: Understood) -> dict[str, Any]:
        return {
            "name": found.name,
            "kind": found.kind,
            "axes": list(found.axes),
            "wrong": found.wrong,
            "responses": list(found.responses),
            "tables": [tabled(each) for each in found.tables],
        }


def _bundled() -> list[str]:
    """Names of the bundled machines."""
    return sorted(each.stem for each in (BUNDLED / "machines").glob("*.toml"))


def _preview(found: Understood) -> Chart:
    """The columns with a role over the same time; those without one if none has."""
    assert found.guess is not None
    roles: Mapping[str, str] = {each.name: role for role, each in found.guess.mapping.items() if role != "time"}
    names = [name for name in found.columns if name in roles][:6] or list(found.columns)[:4]
    panels = tuple(
        Panel(found.units.get(name) or "no unit", (Curve(*found.columns[name], name, i),))
        for i, name in enumerate(names)
    )
    return Chart("time (s)", panels, height=1.4 * max(len(panels), 1))
