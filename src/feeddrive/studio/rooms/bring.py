"""The Bring page of the studio: import of files, assignment of column roles, and identification of models from them."""

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
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name, tabled
from feeddrive.studio.uploads import LOG, MACHINE, PROGRAM, RESPONSES, Understood, safe_name, stem_of, understand
from feeddrive.studio.works import Shown, fitted, toured
from feeddrive.workflow.frf import FrfRequest
from feeddrive.workflow.identify_responses import IdentifyRequest
from feeddrive.workflow.tour import MACHINE as MACHINE_OF_TOUR
from feeddrive.workflow.tour import TourRequest
from feeddrive.workflow.tune_sources import LOAD, MOTOR

_ROLES, _CHOSEN = "roles of columns, as the page had them", "responses that were chosen on the page"


class Bring(Room):
    """The page for the import of machines, logs, responses and part programs."""

    name = "bring"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.files: dict[str, Understood] = {}
        self.open = ""  # the file that is shown
        self.identified: Shown | None = None  # the last identification
        self._made_of = ""  # the file that it was about
        self.machine: Path | None = None  # that it wrote
        self.start_from = ""  # the machine that is chosen before a person chooses one
        self._began = False

    def show(self) -> Said:
        """Return the bundled machines, the files, the columns of the open file, and the last identification."""
        if self.desk.brought and not self._began:
            self._began = True
            self._read([name.name for name in self.desk.brought])
        words: dict[str, Any] = {
            "bundled": _bundled(),
            "files": [self._file(name) for name in self.files.values()],
            "open": self.open,
            "made": None,
            "roles": dict(ROLES),
            "start_from": self.start_from,
            "offers_tour": not self.files and self.desk.bench is None,
        }
        charts = dict[str, Chart]()
        opened = self.files.get(self.open)
        if opened is not None and opened.guess is not None:
            words["columns"] = self._columns(opened)
            charts["columns"] = _preview(opened)
        if self.identified is not None:
            words["made"] = {**self.identified.words, "of": self._made_of, "machine": self.machine is not None}
            charts |= self.identified.charts
        return Said(words, charts)

    @act
    def look(self, asked: Asked) -> None:
        """Read uploaded files and report their content."""
        names = asked.texts("names")
        if not names:
            raise ParameterError("no file is named: choose one, or drop it on the page")
        self._read(names)

    @act
    def pick(self, asked: Asked) -> None:
        """Select a file for display in the tab."""
        self.open = self._known(asked).name

    @act
    def drop(self, asked: Asked) -> None:
        """Remove a file from the list; the file itself is kept."""
        file = self._known(asked)
        del self.files[file.name]
        self.desk.files.pop(file.name, None)
        self.desk.programs.pop(file.name, None)
        self.open = "" if self.open == file.name else self.open

    @act
    def bundled(self, asked: Asked) -> Said:
        """Open a bundled machine for tuning."""
        return self._put(asked.choice("name", _bundled()), asked)

    @act
    def tour(self, _: Asked) -> None:
        """Simulate and open the log of the tour; the identification starts from the machine file of the simulated
        controller.
        """
        out = self.desk.folder / "tour"
        request = TourRequest(out=out)

        def then(contents: list[Understood]) -> None:
            self.desk.did("tour", request)
            self.start_from = MACHINE_OF_TOUR
            for content in contents:
                self._show(content, content.name, out / content.name)

        self.desk.start(self.name, "simulate the log of the tour", partial(toured, request), then)

    @act
    def axis(self, asked: Asked) -> Said:
        """Open an axis of an uploaded machine file; `at` lists files of the same axis at other positions."""
        file = self._known(asked)
        if file.kind != MACHINE:
            raise ParameterError(f"{file.name} is no machine file but: {file.kind}")
        return self._put(self._path(file.name), asked)

    @act
    def role(self, asked: Asked) -> None:
        """Assign a role to a column, with a unit or a factor; an empty role removes it."""
        file = self._known(asked)
        guess, column = file.guess, asked.text("column")
        known = (
            set[str]() if guess is None else {*file.columns, *(assigned.name for assigned in guess.mapping.values())}
        )
        if guess is None or column not in known:
            raise ParameterError(f"{file.name} has no column {column!r:.60}{nearest(column, known)}")
        role = asked.choice("role", ["", *ROLES])
        # a column has one role and a role one column: both earlier assignments end
        columns = {key: assigned for key, assigned in guess.mapping.items() if assigned.name != column and key != role}
        reasons = {key: guess.mapping.reasons.get(key, "") for key in columns}
        if role:
            columns[role], reasons[role] = self._column(asked, column), "chosen"
        mapping = replace(guess.mapping, columns=columns, reasons=reasons)
        self.files[file.name] = replace(file, guess=replace(guess, mapping=mapping))

    @act
    def identify(self, asked: Asked) -> None:
        """Identify masses, friction and dead time, or modes. A machine file is written if the law is known."""
        file = self._known(asked)
        path, out = self._path(file.name), self._free(f"identified_{stem_of(file.name)}")
        unit = asked.text_or_none("unit")
        request = IdentifyRequest(
            path,
            channels=self._roles(file) if file.kind == LOG else None,
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
        self._start("identify", file.name, f"identify {file.name}", request)

    @act
    def estimate(self, asked: Asked) -> None:
        """Estimate frequency responses from logs of one measurement."""
        file = self._known(asked)
        if file.kind != LOG:
            raise ParameterError(f"{file.name} is no log but: {file.kind}")
        names = [other.name for other in self.files.values() if other.kind == LOG and other.name != file.name]
        more = [self._path(other) for other in names if asked.yes("all")]
        out = self._free(f"frf_{stem_of(file.name)}")
        logs = (self._path(file.name), *more)
        request = FrfRequest(logs, channels=self._roles(file), out=out, sample_time=asked.number_or_none("sample_time"))
        self._start("frf", file.name, f"estimate responses from {file.name}", request)

    @act
    def responses(self, asked: Asked) -> Said:
        """Open measured responses, with or without a machine file for the reference controller."""
        file = self._known(asked)
        if file.kind != RESPONSES:
            raise ParameterError(f"{file.name} holds no frequency responses")
        places = [self._path(other) for other in asked.texts("at")]
        bench = bench_of_responses(
            self._chosen(file, asked),
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
        """Open the machine file written by the identification."""
        if self.machine is None:
            raise ParameterError("no machine file was identified yet")
        friction = None if self.identified is None else self.identified.friction
        self.desk.put(replace(bench_of(self.machine), friction=friction))
        return self._on("tune")

    def _put(self, machine: str | Path, asked: Asked) -> Said:
        axis = asked.text_or_none("axis")
        at = [self._path(other) for other in asked.texts("at")]
        file = read_machine(machine)
        if axis is None and len(file.loops) > 1:
            return Said({**self.show().words, "ask_axis": {"name": asked.text("name"), "axes": list(file.loops)}})
        self.desk.put(bench_of(machine, axis, at=at))
        return self._on("tune")

    def _chosen(self, file: Understood, asked: Asked) -> Path:
        """Return the path of the file, or of a new file with the responses selected from it."""
        path, load = self._path(file.name), asked.text_or_none("load")
        if load is None:
            return path
        there = read_frfs(path)
        # under the names by which the tuner recognizes the encoders
        chosen = [replace(there[asked.choice("load", there)], output=LOAD[0])]
        if asked.text_or_none("motor") is not None:
            chosen.append(replace(there[asked.choice("motor", there)], output=MOTOR[0]))
        kept = free_name(self.desk.folder, f"chosen_{stem_of(file.name)}.csv")
        write_frf(kept, *chosen)
        self.desk.kept[kept] = _CHOSEN
        return kept

    def _machine(self, asked: Asked) -> str | Path | None:
        """Return the requested machine, uploaded or bundled; None if none is named."""
        name = asked.text_or_none("machine")
        if name is None:
            return None
        return self._path(name) if name in self.files else asked.choice("machine", _bundled())

    def _on(self, room: str) -> Said:
        answer = self.show()
        return Said({**answer.words, "go": room}, answer.charts)

    def _read(self, names: Sequence[str]) -> None:
        what = f"read {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        paths = {name: self._path(name) for name in names}

        def then(contents: list[Understood]) -> None:
            for (name, path), content in zip(paths.items(), contents, strict=True):
                self._show(content, name, path)

        self.desk.start(self.name, what, partial(understand, [*paths.values()]), then)

    def _start(self, command: str, name: str, what: str, request: Any) -> None:
        def then(shown: Shown) -> None:
            self.desk.did(command, request)
            self._made_of = name
            self._finished(shown)

        self.desk.start(self.name, what, partial(fitted, command, request), then)

    def _finished(self, shown: Shown) -> None:
        places = shown.files
        self.machine = next((path for path in places.values() if path.name == "machine.toml"), None)
        responses = [path for path in places.values() if path.suffix in (".csv", ".parquet") and path.is_file()]
        self.identified = shown
        # read in this process, unlike uploads: feeddrive has just written these files
        for path, content in zip(responses, understand(responses, Progress()), strict=True):
            # what was estimated is a file like one that was brought, by the name of its directory: all are frf.csv
            self._show(content, path.parent.name + path.suffix, path)

    def _show(self, content: Understood, name: str, path: Path) -> None:
        """Open a file under a name, replacing an earlier one of that name."""
        self.files[name], self.desk.files[name], self.open = replace(content, name=name), path, name
        self.desk.programs.pop(name, None)
        if content.kind == PROGRAM:
            self.desk.programs[name] = path

    def _free(self, name: str) -> Path:
        """Return an unused path for a result. Earlier files are never replaced, since an undo may return to them."""
        return free_name(self.desk.folder, name)

    def _known(self, asked: Asked) -> Understood:
        name = asked.text("name")
        if name not in self.files:
            raise ParameterError(f"no file {name!r:.80} was brought{nearest(name, self.files)}")
        return self.files[name]

    def _path(self, name: str) -> Path:
        """Return the path of a file that was uploaded, computed or named on the command line."""
        path = self.desk.files.get(safe_name(name))
        # a symbolic link put into the folder could lead to any file
        if path is None or not path.is_file() or path.is_symlink():
            raise ParameterError(f"no file {name!r:.80} was brought")
        return path

    def _roles(self, content: Understood) -> Path:
        assert content.guess is not None
        self.desk.check_free()
        text = content.guess.toml(self._path(content.name))
        return self.desk.keep(f"roles_{stem_of(content.name)}.toml", text.encode(), _ROLES)

    @staticmethod
    def _column(asked: Asked, name: str) -> Column:
        """Return a column with the unit and the factor entered by the user."""
        return Column(name=name, unit=asked.text_or_none("unit") or "", factor=asked.number_or_none("factor"))

    def _columns(self, content: Understood) -> list[dict[str, Any]]:
        """Return each column with role, unit and reason; assigned columns first, then those that need a factor."""
        assert content.guess is not None
        roles = {assigned.name: (role, assigned) for role, assigned in content.guess.mapping.items()}
        needs = {need.column: (role, need.what) for role, need in content.guess.needs.items()}
        shown = list[dict[str, Any]]()
        for name in dict.fromkeys([*roles, *needs, *content.columns]):
            role, column = roles.get(name, ("", None))
            why = content.guess.mapping.reasons.get(role, "") if role else content.guess.unused.get(name, "")
            if name in needs and not role:
                why = f"may be {needs[name][0]}: needs a factor, {needs[name][1]}"
            shown.append(
                {
                    "column": name,
                    "role": role,
                    "unit": "" if column is None else column.unit,
                    "factor": None if column is None else column.factor,
                    "stated": content.units.get(name, ""),
                    "why": why,
                }
            )
        return shown

    @staticmethod
    def _file(content: Understood) -> dict[str, Any]:
        return {
            "name": content.name,
            "kind": content.kind,
            "axes": list(content.axes),
            "wrong": content.wrong,
            "responses": list(content.responses),
            "tables": [tabled(table) for table in content.tables],
        }


def _bundled() -> list[str]:
    """Return the names of the bundled machines."""
    return sorted(path.stem for path in (BUNDLED / "machines").glob("*.toml"))


def _preview(content: Understood) -> Chart:
    """Plot up to six columns with a role over time, or the first four columns if none has a role."""
    assert content.guess is not None
    roles: Mapping[str, str] = {column.name: role for role, column in content.guess.mapping.items() if role != "time"}
    names = [name for name in content.columns if name in roles][:6] or list(content.columns)[:4]
    panels = tuple(
        Panel(content.units.get(name) or "no unit", (Curve(*content.columns[name], name, i),))
        for i, name in enumerate(names)
    )
    return Chart("time (s)", panels, height=1.4 * max(len(panels), 1))
