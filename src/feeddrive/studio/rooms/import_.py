"""The Import page of the studio: files, the roles of their columns, and identification of models from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import Any, cast

import numpy as np

from feeddrive.files.columns import ROLES, Column, unit_of
from feeddrive.files.frf import read_frfs, write_frf
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.files.mapping import Guess, Need
from feeddrive.language import units
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.plot.chart import Chart
from feeddrive.studio.bench import bench_of, bench_of_responses
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name, tabled
from feeddrive.studio.log_check import Check
from feeddrive.studio.uploads import LOG, MACHINE, PROGRAM, RESPONSES, Understood, safe_name, stem_of, understand
from feeddrive.studio.works import Shown, fitted, toured
from feeddrive.workflow.channels import CHOSEN
from feeddrive.workflow.force import SIGNALS, ForceRequest, ForceScale
from feeddrive.workflow.force import scale as force_scale
from feeddrive.workflow.frf import FrfRequest
from feeddrive.workflow.identify_responses import IdentifyRequest
from feeddrive.workflow.tour import MACHINE as MACHINE_OF_TOUR
from feeddrive.workflow.tour import TourRequest
from feeddrive.workflow.tune_sources import LOAD, MOTOR

_ACTING = ("force", "torque", "current", "command")  # roles of which a unit may need a rated value
_NO_UNIT = "; no unit is stated"  # from here on a reason says which unit was assumed
_COURSE = 100  # points of the small picture in the row of a column, which is 84 pixels wide
# what the page sends of a data sheet
_ENTERED = (
    "signal",
    *("rated", "rated_unit", "full", "at_full", "at_full_unit", "torque_constant", "motor_constant"),
    *("amplitude", "lead_mm", "gear", "inverted"),
)
_ROLES, _CHOSEN = "roles of columns, as the page had them", "responses that were chosen on the page"


class Import(Room):
    """The page for the import of machines, logs, responses and part programs."""

    name = "import"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.files: dict[str, Understood] = {}
        self.open = ""  # the file that is shown
        self.unread: dict[str, Path] = {}  # files that wait to be read
        self.queue: dict[str, None] = {}  # files that were read and wait for their turn, the next one first
        self._sample_times: dict[Path, float] = {}  # s, of logs without a clock
        self._reading: dict[str, Path] = {}  # files that are being read
        self._used: set[str] = set()  # files whose columns were assigned and used
        self._told: set[tuple[str, str]] = set()  # files and columns of which the user chose the role
        self._typed: dict[tuple[str, str], str] = {}  # units that the user entered, by file and column
        # factors from the data sheet, and what was entered for them, by file and column
        self._scales: dict[tuple[str, str], tuple[ForceScale, dict[str, Any]]] = {}
        self.identified: Shown | None = None  # the last identification
        self._made_of: tuple[str, ...] = ()  # the files that it was about
        self.machine: Path | None = None  # that it wrote
        self.start_from = ""  # the machine that is chosen before a person chooses one
        self._began = False

    def show(self) -> Said:
        """Return the bundled machines, the files and their queue, the columns of the open file, and the last result."""
        if self.desk.brought and not self._began:
            self._began = True
            self._read([name.name for name in self.desk.brought])
        words: dict[str, Any] = {
            "bundled": _bundled(),
            "files": [self._file(name) for name in self.files.values()],
            "open": self.open,
            "queue": [*self.queue, *(name for name in self.unread if name not in self.queue)],
            "made": None,
            "roles": dict(ROLES),
            "start_from": self.start_from,
            "offers_tour": not (self.files or self.unread) and self.desk.bench is None,
        }
        charts = dict[str, Chart]()
        opened = self.files.get(self.open)
        if opened is not None and opened.guess is not None:
            check = self._check(opened)
            left_out = {} if opened.log is None else opened.log.left_out
            words |= {
                "columns": self._columns(opened),
                "axes": [*opened.guesses],
                "axis": opened.guess.mapping.axis,
                "left_out": [f"{name} ({why})" for name, why in left_out.items()],
                "check": check.words,
                "remarks": check.sentences,
            }
            charts["check"] = check.chart
        if self.identified is not None:
            words["made"] = {
                **self.identified.words,
                "of": " and ".join(self._made_of),
                "machine": self.machine is not None,
            }
            charts |= self.identified.charts
        return Said(words, charts)

    @act
    def look(self, asked: Asked) -> None:
        """Read uploaded files, and open the first one unless the columns of another file are being assigned.

        `sample_time` is the sample time, s, of logs without a clock that were refused before.
        """
        names = asked.texts("names")
        if not names:
            raise ParameterError("no file is named: choose one, or drop it on the page")
        self._read(names, asked.number_or_none("sample_time"))

    @act
    def pick(self, asked: Asked) -> None:
        """Open a file before its turn. A file whose columns were being assigned takes the next turn."""
        name, before = self._known(asked).name, self.open
        if name != before:
            if self._assigning:
                self.queue = {before: None, **self.queue}
            self._open(name)

    @act
    def drop(self, asked: Asked) -> None:
        """Remove a file from the list or the queue; the file itself is kept. The next file is opened in its place."""
        name = asked.text("name")
        if self.unread.pop(name, None) is None:
            self._known(asked)
        self.files.pop(name, None)
        self.queue.pop(name, None)
        self.desk.files.pop(name, None)
        self.desk.programs.pop(name, None)
        if self.open == name:
            self.open = ""
            if self.queue:
                self._open(next(iter(self.queue)))

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
                self._add(content, content.name, out / content.name)
                self._open(content.name)

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
        known = set[str]() if guess is None else {*file.names, *(assigned.name for assigned in guess.mapping.values())}
        if guess is None or column not in known:
            raise ParameterError(f"{file.name} has no column {column!r:.60}{nearest(column, known)}")
        role = asked.choice("role", ["", *ROLES])
        assigned = Column(name=column, unit=asked.text_or_none("unit") or "", factor=asked.number_or_none("factor"))
        self._assign(file, guess, column, role, assigned, CHOSEN)
        self._scales.pop((file.name, column), None)
        self._told.add((file.name, column))
        self._typed[file.name, column] = assigned.unit

    @act
    def unit(self, asked: Asked) -> None:
        """Set the unit of a column, and that of all other columns of its kind that state none either."""
        file = self._known(asked)
        guess, name = file.guess, asked.text("column")
        role = next((role for role, column in guess.mapping.items() if column.name == name), "") if guess else ""
        if guess is None or not role:
            raise ParameterError(f"{file.name} has no column {name!r:.60} with a role")
        alike = {
            other: column
            for other, column in guess.mapping.items()
            if ROLES[other] == ROLES[role] and not column.factor and not self._unit(file, column.name)
        }
        for other, column in {**alike, role: guess.mapping[role]}.items():
            # a guess stays one: only its unit was chosen
            why, _, _ = guess.mapping.reasons.get(other, "").partition(_NO_UNIT)
            now = self.files[file.name]
            assert now.guess is not None
            self._assign(now, now.guess, column.name, other, Column(name=column.name, unit=asked.text("unit")), why)
            self._typed[file.name, column.name] = asked.text("unit")

    @act
    def choose_axis(self, asked: Asked) -> None:
        """Show the columns of another axis of a log. The roles assigned for each axis are kept."""
        file = self._known(asked)
        axis = asked.choice("axis", file.guesses)
        self._put_guess(file, file.guesses[axis])

    @act
    def scale(self, asked: Asked) -> None:
        """Compute the factor of a column in percent, A or V from the data sheet, as `feeddrive force` does."""
        file = self._known(asked)
        guess, column = file.guess, asked.text("column")
        if guess is None or column not in file.names:
            raise ParameterError(f"{file.name} has no column {column!r:.60}{nearest(column, file.names)}")
        lead = asked.number_or_none("lead_mm")
        request = ForceRequest(
            asked.choice("signal", SIGNALS),
            column=column,
            rated=_sized(asked, "rated"),
            at_full=_sized(asked, "at_full"),
            full=_or(asked.number_or_none("full"), 10.0),
            torque_constant=asked.number_or_none("torque_constant"),
            motor_constant=asked.number_or_none("motor_constant"),
            amplitude=asked.yes("amplitude"),
            lead=None if lead is None else units.scaled(lead, 1e-3),
            gear=_or(asked.number_or_none("gear"), 1.0),
            inverted=asked.yes("inverted"),
        )
        conversion, unit = force_scale(request), self._unit(file, column)
        factor = units.decimal(_signal(unit)[1] * conversion.factor)
        # a role that the user chose stays chosen, whatever its samples show
        why = CHOSEN if (file.name, column) in self._told else _computed(conversion)
        self._assign(file, guess, column, conversion.role, Column(name=column, factor=factor), why)
        entered = {key: value for key, value in asked.parameters.items() if key in _ENTERED}
        self._scales[file.name, column] = conversion, entered
        # the column has a factor now, but its numbers are still in this unit
        self._typed[file.name, column] = unit

    def _assign(self, file: Understood, guess: Guess, column: str, role: str, assigned: Column, why: str) -> None:
        """Give a column a role or none; a role whose unit needs a rated value waits for it in `needs`."""
        # a column has one role and a role one column: both earlier assignments end
        columns = {key: other for key, other in guess.mapping.items() if other.name != column and key != role}
        needs = {key: need for key, need in guess.needs.items() if need.column != column and key != role}
        reasons = {key: guess.mapping.reasons.get(key, "") for key in columns}
        unit = assigned.unit or file.units.get(column, "")
        signal, _ = _signal(unit)
        if role in ("force", "torque") and signal and assigned.factor is None:
            needs[role] = Need(column, f"{ROLES[role]} per {unit_of(unit) or unit}", unit_of(unit) or unit)
        elif role:
            columns[role], reasons[role] = assigned, why
        mapping = replace(guess.mapping, columns=columns, reasons=reasons)
        self._put_guess(file, replace(guess, mapping=mapping, needs=needs))

    def _unit(self, file: Understood, column: str) -> str:
        """Return the unit of a column, as entered by the user or else as stated in the file or the column name."""
        assert file.guess is not None
        named = [other.unit for other in file.guess.mapping.values() if other.name == column]
        named += [need.signal for need in file.guess.needs.values() if need.column == column]
        stated = (self._typed.get((file.name, column), ""), file.units.get(column, ""), *named)
        return next(filter(None, stated), "")

    def _put_guess(self, file: Understood, guess: Guess) -> None:
        guesses = {**file.guesses, guess.mapping.axis: guess} if file.guesses else file.guesses
        self.files[file.name] = replace(file, guess=guess, guesses=guesses, check=None)
        self._used.discard(file.name)

    @act
    def identify(self, asked: Asked) -> None:
        """Identify masses, friction and dead time, or modes. A machine file is written if the law is known.

        `also` lists further logs of the same axis, whose values are pooled; the roles of the columns are those of the
        first log.
        """
        file = self._known(asked)
        names = tuple(dict.fromkeys([file.name, *asked.texts("also")]))
        for name in names if len(names) > 1 else ():
            other = self.files.get(name)
            if other is None or other.kind != LOG or other.wrong:
                raise ParameterError(f"{name:.80} is no log that can be pooled with {file.name}: {_why_not(other)}")
        out = self._free(f"identified_{stem_of(file.name)}")
        unit = asked.text_or_none("unit")
        request = IdentifyRequest(
            tuple(map(self._path, names)),
            channels=self._roles(file) if file.kind == LOG else None,
            out=out,
            machine=self._machine(asked),
            axis=asked.text_or_none("axis"),
            motor=asked.text_or_none("motor"),
            load=asked.text_or_none("load"),
            lead=asked.number_or_none("lead"),
            rotary=asked.yes("rotary"),
            force_constant=asked.number_or_none("force_constant"),
            sample_time=asked.number_or_none("sample_time"),
            law=asked.text_or_none("law"),
            unit=() if unit is None else (unit,),
        )
        self._start("identify", names, f"identify {' and '.join(names)}", request)

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
        self._start("frf", (file.name,), f"estimate responses from {file.name}", request)

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
        self._used.add(file.name)
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

    def freed(self) -> bool:
        """Read the files that waited for the end of a job."""
        # of a job that failed or was canceled, which the page shows with its reason
        for name, path in self._reading.items():
            if self.unread.get(name) == path:
                del self.unread[name]
        return self._read_on()

    def _read(self, names: Sequence[str], sample_time: float | None = None) -> None:
        paths = {name: self._path(name) for name in names}
        self.unread |= paths
        if sample_time is not None:
            self._sample_times |= dict.fromkeys(paths.values(), sample_time)
        self._read_on()

    def _read_on(self) -> bool:
        """Start reading the waiting files unless a job is running; return True if reading was started."""
        if not self.unread or not self.desk.is_free:
            return False
        paths = self._reading = dict(self.unread)
        first = next(iter(paths))
        what = f"read {first}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
        # it takes a second, in which the files are read, and is needed for the first rated value that is entered
        Thread(target=import_module, args=("scipy.signal",), daemon=True).start()
        work = partial(understand, [*paths.values()], sample_times=dict(self._sample_times))

        def then(contents: list[Understood]) -> None:
            for (name, path), content in zip(paths.items(), contents, strict=True):
                # a file that was removed or sent again meanwhile is not the one that was read
                if self.unread.get(name) == path:
                    del self.unread[name]
                    self._add(content, name, path)
                    self._take_turn(name)

        self.desk.start(self.name, what, work, then)
        return True

    @property
    def _assigning(self) -> bool:
        """True while the columns or responses of the open file are being assigned."""
        file = self.files.get(self.open)
        return file is not None and file.kind in (LOG, RESPONSES) and file.name not in self._used

    def _take_turn(self, name: str) -> None:
        """Open a file that was read, or queue it until those before it are done."""
        content = self.files[name]
        if name == self.open or (not self.queue and not self._assigning):
            self._open(name)
        elif content.kind in (LOG, RESPONSES) and not content.wrong:
            # other files need no turn: a machine can be chosen beside a log, a part program is run under Program
            self.queue[name] = None

    def _open(self, name: str) -> None:
        self.open = name
        self.queue.pop(name, None)

    def _start(self, command: str, names: tuple[str, ...], what: str, request: Any) -> None:
        def then(shown: Shown) -> None:
            self.desk.did(command, request)
            self._made_of = names
            # users know a file by its name, not by its place on the server
            places = {str(path): known for known, path in self.desk.files.items()}
            self._finished(replace(shown, words=_renamed(shown.words, places)))

        self.desk.start(self.name, what, partial(fitted, command, request), then)

    def _finished(self, shown: Shown) -> None:
        places = shown.files
        self.machine = next((path for path in places.values() if path.name == "machine.toml"), None)
        responses = [path for path in places.values() if path.suffix in (".csv", ".parquet") and path.is_file()]
        self.identified = shown
        self._used.update(self._made_of)
        # a log that was pooled needs no turn of its own
        self.queue = {name: None for name in self.queue if name not in self._made_of}
        # read in this process, unlike uploads: feeddrive has just written these files
        for path, content in zip(responses, understand(responses, Progress()), strict=True):
            # what was estimated is a file like one that was brought, by the name of its directory: all are frf.csv
            name = path.parent.name + path.suffix
            self._add(content, name, path)
            self._open(name)

    def _add(self, content: Understood, name: str, path: Path) -> None:
        """List a file under a name, replacing an earlier one of that name."""
        self.files[name], self.desk.files[name] = replace(content, name=name), path
        self._used.discard(name)
        # of an earlier file of this name
        self._told = {key for key in self._told if key[0] != name}
        self._typed = {key: unit for key, unit in self._typed.items() if key[0] != name}
        self._scales = {key: scale for key, scale in self._scales.items() if key[0] != name}
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

    def _check(self, content: Understood) -> Check:
        if content.check is None:
            content = self.files[content.name] = content.checked()
        assert content.check is not None
        return content.check

    def _columns(self, content: Understood) -> list[dict[str, Any]]:
        """Return each column with role, unit and reason, in the order of the file."""
        assert content.guess is not None
        guess = content.guess
        roles = {column.name: (role, column) for role, column in guess.mapping.items()}
        needs = {need.column: (role, need.what) for role, need in guess.needs.items()}
        others = {
            name
            for axis, other in content.guesses.items()
            if axis != guess.mapping.axis
            for name in (
                *(column.name for column in other.mapping.values()),
                *(need.column for need in other.needs.values()),
            )
        }
        check = self._check(content)
        doubted = {doubt.roles[0] for doubt in check.doubts}
        open_ = {doubt.roles[0] for doubt in check.open_} - doubted
        shown = list[dict[str, Any]]()
        # the order must not depend on the roles: a row stays where it is while a role is chosen in it
        for name in dict.fromkeys([*content.names, *roles, *needs]):
            role, column = roles.get(name, ("", None))
            why = guess.mapping.reasons.get(role, "") if role else guess.unused.get(name, "")
            stated = content.units.get(name, "")
            signal, _ = _signal(self._unit(content, name))
            if name in needs and not role:
                role, what = needs[name]
                why = f"{role}: enter its rated value" if signal else f"needs a factor, {what}"
            elif why == CHOSEN:
                why = "you chose it"
            scale, entered = self._scales.get((content.name, name), (None, {}))
            if scale is not None:
                why = _computed(scale)
            if role in doubted:
                why = "the samples contradict this role"
            # a person who chose the role has settled what the samples cannot
            is_open = role in open_ and guess.mapping.reasons.get(role) != CHOSEN
            if is_open:
                why = "the samples leave this role open"
            if role == "command" and not self._unit(content, name):
                signal = "pid.output"  # what HAL sends has no unit
            shown.append(
                {
                    "column": name,
                    "role": role,
                    "unit": self._typed.get((content.name, name), "") if column is None else column.unit,
                    "factor": None if column is None else column.factor,
                    "stated": stated,
                    "why": why,
                    "missing": column is None and name in needs,
                    "doubted": role in doubted,
                    "open": is_open,
                    "other_axis": not role and name in others,
                    "signal": entered.get("signal", signal) if role in _ACTING else "",
                    "scale": "" if scale is None else scale.table().title,
                    "entered": entered,
                    **_sketch(content, name, role, column),
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
            "no_clock": content.no_clock,
            "responses": list(content.responses),
            "tables": [tabled(table) for table in content.tables],
        }


def _signal(unit: str) -> tuple[str, float]:
    """Return the signal of `feeddrive force` that corresponds to a unit, and the conversion factor: 0.001 for mA to A.

    The signal is empty for a unit of another quantity, and for one of a force or a torque.
    """
    known = unit_of(unit) or unit
    for of, signal in (("percent", "percent"), ("permille", "per-mille")):
        if known == of:
            return signal, 1.0
    for signal in ("A", "V"):
        with suppress(ParameterError):
            return (signal, units.factor(known, signal)) if known else ("", 1.0)
    return "", 1.0


def _sketch(content: Understood, name: str, role: str, column: Column | None) -> dict[str, Any]:
    """Return the curve of a column as whole numbers from 0 to 100, and its minimum and maximum in the assigned unit."""
    if name not in content.columns:
        return {"course": [], "low": "", "high": ""}
    values = content.columns[name][1]
    low, high = float(np.min(values)), float(np.max(values))
    kept = values[:: -(-values.size // _COURSE)]
    course = np.rint(100.0 * (kept - low) / (high - low)) if high > low else np.full(kept.size, 50.0)
    factor = 1.0 if column is None or column.factor is None else column.factor
    unit = content.units.get(name, "")
    if column is not None:
        unit = column.unit or (unit if column.factor is None else ROLES[role])
    ends = sorted((factor * low, factor * high))
    if factor < 0.0:
        course = 100.0 - course
    unit = {"percent": "%", "permille": "‰"}.get(unit, unit)
    shown = [str(Text(f"{Quantity(end):3} {unit}")).rstrip() for end in ends]
    return {"course": [int(value) for value in course], "low": shown[0], "high": shown[1]}


def _why_not(file: Understood | None) -> str:
    return "no such file was brought" if file is None else file.wrong or file.kind


def _sized(asked: Asked, name: str) -> str | None:
    """Return a value with its unit as `feeddrive force` reads it, `3.2:N m`; None if no value was entered."""
    value = asked.number_or_none(name)
    return None if value is None else f"{value!r}:{asked.text(f'{name}_unit')}"


def _or(value: float | None, usual: float) -> float:
    return usual if value is None else value


def _computed(conversion: ForceScale) -> str:
    """Return the data from which a factor was computed, as the reason for the role: `you gave rated 850 N / 100`."""
    return Text(f"you gave {joined(', ', (step for step, _, _ in conversion.steps))}")


def _renamed(words: Any, names: Mapping[str, str]) -> Any:
    """Return JSON data with other names for files, wherever they are mentioned."""
    if isinstance(words, str):
        for place, name in names.items():
            words = words.replace(place, name)
        return words
    if isinstance(words, Mapping):
        return {key: _renamed(value, names) for key, value in cast("Mapping[str, Any]", words).items()}
    if isinstance(words, (list, tuple)):
        return [_renamed(value, names) for value in cast("Sequence[Any]", words)]
    return words


def _bundled() -> list[str]:
    """Return the names of the bundled machines."""
    return sorted(path.stem for path in (BUNDLED / "machines").glob("*.toml"))
