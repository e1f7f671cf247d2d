"""The shared state of a page, and `Room`, the base class of its tabs with their actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from feeddrive.files.atomic_io import write_whole
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import USUAL, Units
from feeddrive.language.table import Grid, Table
from feeddrive.plot.chart import Chart
from feeddrive.studio.jobs import Found, Job, JobState
from feeddrive.studio.live import Followable
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.filters import difference, with_filters
from feeddrive.workflow.adjust import AdjustRequest, adjusting
from feeddrive.workflow.tune import TuneRequest

if TYPE_CHECKING:
    from feeddrive.blocks.families import Filter
    from feeddrive.files.machine import MachineFile
    from feeddrive.loop.control import Control
    from feeddrive.studio.bench import Bench
    from feeddrive.tuning.by_hand import ByHand
    from feeddrive.workflow.command import Request


F = TypeVar("F", bound=Callable[..., Any])
_MARK = "studio_act"


@dataclass(frozen=True)
class Said:
    """The response of a tab to a request from the page.

    words   content of the message header, to be encoded as JSON
    charts  charts by name
    """

    words: Mapping[str, Any] = field(default_factory=dict[str, Any])
    charts: Mapping[str, Chart] = field(default_factory=dict[str, Chart])


class Asked:
    """The parameters of a request from the page. The methods raise ParameterError for a missing or mistyped value.

    page  the connection through which it came: one for each tab of a browser, and another one after a reload
    """

    def __init__(self, parameters: Mapping[str, Any], page: object = None) -> None:
        self.parameters, self.page = parameters, page

    def text(self, name: str) -> str:
        """Return a string parameter."""
        value = self.parameters.get(name)
        if not isinstance(value, str):
            raise ParameterError(f"the page must send {name} as a text, not {value!r:.60}")
        return value

    def number(self, name: str) -> float:
        """Return a number parameter."""
        entry = self.parameters.get(name)
        if isinstance(entry, bool) or not isinstance(entry, (int, float)):
            raise ParameterError(f"{name} must be a number, not {entry!r:.60}")
        try:
            value = float(entry)
        except OverflowError:
            # JSON allows whole numbers of any length
            value = math.inf
        if not math.isfinite(value):
            raise ParameterError(f"{name} must be a finite number, not {entry!r:.60}")
        return value

    def whole(self, name: str) -> int:
        """Return a parameter that is a whole number."""
        value = self.number(name)
        if value != int(value):
            raise ParameterError(f"{name} must be a whole number, not {value!r}")
        return int(value)

    def yes(self, name: str, usual: bool = False) -> bool:
        """Return a Boolean parameter; `usual` is its default."""
        value = self.parameters.get(name, usual)
        if not isinstance(value, bool):
            raise ParameterError(f"{name} must be true or false, not {value!r:.60}")
        return value

    def text_or_none(self, name: str) -> str | None:
        """Return a string parameter; None if it is missing or empty."""
        return self.text(name) if self.parameters.get(name) not in (None, "") else None

    def number_or_none(self, name: str) -> float | None:
        """Return a number parameter; None if it is missing or empty."""
        return self.number(name) if self.parameters.get(name) not in (None, "") else None

    def texts(self, name: str) -> list[str]:
        """Return a parameter that is a list of strings, possibly empty."""
        values = self.parameters.get(name, [])
        if not isinstance(values, list) or not all(isinstance(value, str) for value in cast("list[Any]", values)):
            raise ParameterError(f"{name} must be a list of texts, not {values!r:.60}")
        return cast("list[str]", values)

    def choice(self, name: str, among: Iterable[str]) -> str:
        """Return a string parameter that must be one of `among`."""
        value, known = self.text(name), tuple(among)
        if value not in known:
            raise ParameterError(f"{name} must be one of {', '.join(known)}, not '{value:.60}'")
        return value


def tabled(table: Table | Grid, units: Units = USUAL) -> dict[str, Any]:
    """Convert a table to JSON data for the page, in the displayed units."""
    grid = table if isinstance(table, Grid) else table.grid(units)
    return {"title": grid.title, "heads": grid.heads, "rows": grid.rows}


def act(method: F) -> F:
    """Mark a method of a `Room` as an action of the page: `move` of the tab `tune` is requested as `tune.move`."""
    setattr(method, _MARK, True)
    return method


class Room:
    """A tab of the page, or its tour, with its own state; the `Desk` holds the state that they share.

    An action takes an `Asked` and returns a `Said`; None stands for the result of `show()`.
    """

    name: ClassVar[str] = ""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    def show(self) -> Said:
        """Return the state and pictures of the tab, for a page that has just been opened or reloaded."""
        return Said()

    def begin(self) -> None:
        """Discard the state of the previous source."""

    def freed(self) -> bool:
        """Start work that was waiting for the end of a job; return True if this changes the display of the tab."""
        return False

    def do(self, name: str, asked: Asked) -> Said:
        """Run an action, by name. Raises ParameterError for an unknown one."""
        # looked up in the class, since a property of the instance would be evaluated
        known = [attribute for attribute in dir(self) if getattr(getattr(type(self), attribute, None), _MARK, False)]
        if name == "show":
            return self.show()
        if name not in known:
            raise ParameterError(f"the room {self.name} has no act '{name:.60}': it has {', '.join(['show', *known])}")
        answer = getattr(self, name)(asked)
        return self.show() if answer is None else answer


T = TypeVar("T")
Values = dict[str, float]
_UNDONE = 200  # steps that are kept
_NOT_MADE = "a control that was chosen on the page before a search had ended, or of a comparison"
_ANOTHER = "This result belongs to an earlier control. Run it again for the current one."


def free_name(folder: Path, name: str, content: bytes | None = None) -> Path:
    """Return an unused path in a folder, or that of a file with this content: name.toml, name_2.toml, ..."""
    # equal content may be reused: repeating a step then gives the same commands
    path, count = folder / name, 1
    while path.exists() and (content is None or not path.is_file() or path.read_bytes() != content):
        count += 1
        path = folder / f"{Path(name).stem}_{count}{Path(name).suffix}"
    return path


@dataclass(frozen=True)
class Step:
    """A completed step: a workflow command with its request.

    control  the controller to which its results belong, if any
    epoch    number of the source that was open at that time
    """

    command: str
    request: Request
    control: Control | None = None
    epoch: int = 0


@dataclass(frozen=True, eq=False)
class Held:
    """A stored controller snapshot, for undo, redo and comparison.

    bench          bench with the blocks of the controller
    base, written  machine file into which the controller is written, and the controller now in that file
    off            filters that are switched off
    """

    bench: Bench
    values: Values
    base: str | Path
    written: Control
    off: tuple[Filter, ...] = ()

    @property
    def control(self) -> Control:
        """The stored controller."""
        return self.bench.by_hand.control(self.values)

    def same(self, other: Held) -> bool:
        """Return True if blocks and parameters are identical."""
        return self.bench.by_hand is other.bench.by_hand and (self.values, self.off) == (other.values, other.off)


class Desk:
    """The state of one page. It is not shared between pages.

    folder    folder of the page; it contains the results and, in `brought`, the uploaded files
    bench     the axis being tuned; None before a source was opened
    brought   files named on the command line, stored elsewhere
    files     path of each file by its displayed name: the latest uploaded or computed one
    epoch     number of sources opened so far
    base      machine file into which the current controller is written
    written   controller in that file
    off       filters that were taken out of the loop, and may be put back
    goal      goal, limits and other settings of a search, as fields of `TuneRequest`
    limits    limits by which the loop is judged: those of `goal`
    programs  uploaded part programs by name
    live      sources that may be followed while they are recorded
    drives    drive files whose drives the page may move, as named on the command line
    closing   functions that are called at the end of the session
    left      functions that are called with the page whose connection has ended
    closed    True once the session has ended
    done      steps completed on the page, for all sources
    kept      files that are not outputs of the commands in `done`, with a description of each
    """

    def __init__(
        self,
        folder: Path,
        brought: tuple[Path, ...] = (),
        live: Followable | None = None,
        drives: tuple[Path, ...] = (),
    ) -> None:
        self.folder, self.brought, self.drives = folder, brought, drives
        self.files = {path.name: path for path in brought}
        self.live = live or Followable()
        self.bench: Bench | None = None
        self.epoch = 0
        self.base: str | Path = ""
        self.written: Control | None = None
        self.off: tuple[Filter, ...] = ()
        self.values: Values = {}
        self.goal: dict[str, Any] = {}
        self.limits = Limits()
        self.programs: dict[str, Path] = {}
        self.done: list[Step] = []
        self.job: Job | None = None
        self.undo: list[Held] = []
        self.redo: list[Held] = []
        self._made: tuple[ByHand, Values, Control] | None = None  # the current control, once it is needed
        self.kept: dict[Path, str] = {}
        self._begins = True  # whether the next change is a step of its own, and not one more of a drag
        self.changed: Callable[[], None] = lambda: None  # set by the session: another source
        self.closing: list[Callable[[], None]] = []
        self.closed = False
        self.watched: Callable[[], bool] = lambda: True  # set by the session: whether a page is open
        self.tell: Callable[[str], None] = lambda _: None  # set by the session: show a room again
        self.left: list[Callable[[object], None]] = []
        self.begun: Callable[
            [str, str, Callable[[Progress], Any], Callable[[Any], None], Callable[[Found], None], float], Job
        ]

    def put(self, bench: Bench) -> None:
        """Switch to another source and reset all tabs. Raises ParameterError while a job is running."""
        self.check_free()
        self.bench, self.epoch = bench, self.epoch + 1
        self.values, self.base, self.written = bench.by_hand.values, bench.file, bench.before.start
        self.off = ()
        self.undo, self.redo = [], []
        self._begins = True
        self.changed()

    @property
    def needed(self) -> Bench:
        """The bench. Raises ParameterError if no source has been opened."""
        if self.bench is None:
            raise ParameterError("there is no axis yet: bring a machine file, a log or a frequency response first")
        return self.bench

    def change(self, wanted: Mapping[str, float], *, begins: bool = True) -> None:
        """Change parameters. Raises ParameterError for values out of bounds.

        begins  True for a new undo step, False for a change that continues a drag
        """
        # first of all: values out of bounds must raise before anything has changed
        control = self.needed.by_hand.control(wanted)
        self._begins = self._begins or begins
        if dict(wanted) == self.values:
            return
        if self._begins:
            self._remember()
        self.values, self._begins = dict(wanted), False
        self._made = self.needed.by_hand, self.values, control

    def exchange(self, control: Control, file: Path | None = None) -> None:
        """Replace the current controller by one that may have different blocks; this is one undo step.

        file  a machine file to which a command has written the controller

        Without `file`, the controller will be written into the current machine file or that of the source, if it
        differs from the controller in that file only in filters and parameters. Otherwise a new file is written.
        """
        bench = self.needed.with_control(control)
        self._remember()
        self.bench, self.values, self._begins = bench, bench.by_hand.values, True
        if file is not None:
            self.base, self.written = file, control
            return
        known = ((self.base, self.written), (bench.file, bench.before.start))
        for base, written in known:
            if written is not None and difference(written, control) is not None:
                self.base, self.written = base, written
                return
        self.base, self.written = self._kept(bench), control

    def switch(self, place: int, *, on: bool) -> None:
        """Put a filter that is off, by its index, back into the loop as the last one, or take one out of the loop.

        Raises ParameterError for a filter that does not exist.
        """
        control = self.control
        there = self.off if on else control.filters
        if not 0 <= place < len(there):
            raise ParameterError(f"there is no filter {place + 1} that is {'off' if on else 'on'}")
        if on:
            left = (*self.off[:place], *self.off[place + 1 :])
            self.exchange(with_filters(control, (), (there[place],)))
        else:
            left = (*self.off, there[place])
            self.exchange(with_filters(control, (place,), ()))
        # after the exchange, which remembers the filters that were off before it
        self.off = left

    def aim(self, goal: dict[str, Any]) -> None:
        """Adopt goal and limits, by which the loop is judged in all rooms. Raises ParameterError for invalid ones."""
        if self.bench is not None and "box" in goal:
            self.bench.over(goal["box"])
        # any machine would do: the request raises ParameterError for settings that are invalid
        self.limits = TuneRequest("ball_screw", **goal).limits()
        self.goal = goal

    def change_off(self, wanted: Mapping[str, float], *, begins: bool = True) -> None:
        """Change parameters of a filter that is off, by names such as off.0.frequency; the loop does not change.

        begins  True for a new undo step, False for a change that continues a drag
        """
        off = list(self.off)
        for name, value in wanted.items():
            _, place, field = name.split(".")
            off[int(place)] = replace(off[int(place)], **{field: value})
        self._begins = self._begins or begins
        if self._begins:
            self._remember()
        self.off, self._begins = tuple(off), False

    def forget(self, place: int) -> None:
        """Remove a filter that is off, by its index; this is one undo step.

        Raises ParameterError for an unknown one.
        """
        if not 0 <= place < len(self.off):
            raise ParameterError(f"there is no filter {place + 1} that is off")
        self._remember()
        self.off = (*self.off[:place], *self.off[place + 1 :])
        self._begins = True

    def _kept(self, bench: Bench) -> str | Path:
        """Write the controller to a new machine file, which later steps read, and return the path of this file."""
        if bench.machine is None:
            return bench.file
        return self.keep("begun.toml", bench.text(self.values).encode(), _NOT_MADE)

    def keep(self, name: str, content: bytes, what: str) -> Path:
        """Write a file that is not the output of a command, and list it in the recipe as a file to be kept.

        A number is appended to the name if another file already has this name.
        """
        path = free_name(self.folder, name, content)
        write_whole(path, content)
        self.kept[path] = what
        return path

    def held(self) -> Held:
        """Return a snapshot of the current controller."""
        bench = self.needed
        return Held(bench, dict(self.values), self.base, self.written or bench.before.start, self.off)

    def said_of(self, held: Held, words: Mapping[str, Any]) -> dict[str, Any]:
        """Return the data of a result, with a remark if it belongs to a controller other than the current one."""
        same = held.same(self.held())
        return {**words, "said": [*([] if same else [_ANOTHER]), *words["said"]]}

    def results(self) -> dict[str, str]:
        """Return the result directories of this source by name, latest last.

        The value is a remark if the result belongs to a controller other than the current one, and otherwise empty.
        """
        directories = dict[str, str]()
        for step in self.done:
            out = getattr(step.request, "out", None)
            if step.control is None or step.epoch != self.epoch or not isinstance(out, Path):
                continue
            if out.parent == self.folder and out.is_dir():
                directories.pop(out.name, None)
                changed = difference(step.control, self.control)
                directories[out.name] = "" if changed is not None and changed.is_empty else _ANOTHER
        return directories

    def restore(self, held: Held) -> None:
        """Make a stored controller the current one; this is one undo step."""
        if not held.same(self.held()):
            self._remember()
            self._become(held)

    @contextmanager
    def tried(self) -> Generator[None]:
        """Run a block; if it raises, restore the previous controller with its undo and redo steps."""
        if self.bench is None:
            yield
            return
        held, undo, redo = self.held(), list(self.undo), list(self.redo)
        try:
            yield
        except Exception:
            # after a fault, too, the page must have a control that can be computed
            if not held.same(self.held()):
                self._become(held)
                self.undo, self.redo = undo, redo
            raise

    def back(self) -> None:
        """Undo the last step, if there is one."""
        self._swap(self.undo, self.redo)

    def again(self) -> None:
        """Redo the last undone step, if there is one."""
        self._swap(self.redo, self.undo)

    def _remember(self) -> None:
        self.undo = [*self.undo, self.held()][-_UNDONE:]
        self.redo.clear()

    def _swap(self, source: list[Held], other: list[Held]) -> None:
        if source:
            other.append(self.held())
            self._become(source.pop())

    def _become(self, held: Held) -> None:
        self.bench, self.values, self.base = held.bench, dict(held.values), held.base
        self.written, self.off = held.written, held.off
        self._begins = True

    def did(self, command: str, request: Request, control: Control | None = None) -> None:
        """Record a completed step for the recipe, with the controller to which its results belong."""
        self.done.append(Step(command, request, control, self.epoch))

    def said_again(self, known: Request, request: Request, *, also: bool) -> None:
        """Replace the request of a completed step by an extended one, so that a repetition yields the same files.

        also  True to insert the extended request after the step instead of replacing it
        """
        place = next(k for k, step in enumerate(self.done) if step.request is known)
        # `also` as an index: if true, the slice is empty and the step before it stays
        self.done[place + also : place + 1] = [replace(self.done[place], request=request)]

    def take(self, control: Control, file: Path | None = None) -> None:
        """Make a computed controller the current one; this is one undo step.

        file  the machine file to which a command has written the controller, if any
        """
        changes = difference(self.needed.by_hand.start, control)
        if (
            changes is not None
            and not (changes.removed or changes.added)
            and changes.values.keys() <= self.values.keys()
        ):
            # equal blocks with other numbers: the traced control can be kept, a new one takes half a second to compile
            self.change({name: float(value) for name, value in tree.leaves(control) if name in self.values})
        else:
            self.exchange(control, file)

    @property
    def control(self) -> Control:
        """The current controller."""
        by_hand, known = self.needed.by_hand, self._made
        # `values` is always replaced and never modified, so its identity tells whether it has changed
        if known is None or known[0] is not by_hand or known[1] is not self.values:
            known = self._made = by_hand, self.values, by_hand.control(self.values)
        return known[2]

    def adjusted(self) -> AdjustRequest | None:
        """Return the request that writes the current controller into the machine file; None if it is already there.

        Raises ParameterError if there is no machine.
        """
        bench = self.needed
        bench.needed_loop()
        assert self.written is not None
        fields = adjusting(self.written, self.control)
        # `exchange` selects a machine file from which edits lead to the control
        assert fields is not None
        if not any(fields.values()):
            return None
        return AdjustRequest(
            self.base,
            set=fields["set"],
            add=fields["add"],
            remove=fields["remove"],
            axis=bench.axis,
            out=self.folder / "machine.toml",
        )

    def machine_path(self) -> str | Path:
        """Return a machine file with the current controller: the base file, or one written to the folder.

        Raises ParameterError if there is no machine.
        """
        if self.adjusted() is None:
            return self.base
        path, missing = self.write_machine(), self.not_yet_done()
        if missing is not None:
            self.did("adjust", missing)
        return path

    def not_yet_done(self) -> AdjustRequest | None:
        """Return the request that writes the current controller; None if the file already contains it.

        Raises ParameterError if there is no machine.
        """
        request = self.adjusted()
        if request is None:
            return None
        # only the last writer counts: after an undo and other changes the file holds another control
        writers = [step.request for step in self.done if getattr(step.request, "out", None) == request.out]
        return None if writers and writers[-1] == request else request

    def write_machine(self) -> Path:
        """Write the machine file with the current controller to the folder.

        Raises ParameterError if there is no machine, and while a job may still read the existing file.
        """
        path, text = self.folder / "machine.toml", self.needed.text(self.values)
        if not path.is_file() or path.read_bytes() != text.encode():
            self.check_free()
            write_whole(path, text)
        return path

    def machine(self) -> MachineFile:
        """Return the machine with the current controller."""
        from feeddrive.files.machine import read_machine

        return read_machine(self.machine_path())

    @property
    def is_free(self) -> bool:
        """True unless a job is running."""
        return self.job is None or not self.job.state.going

    def check_free(self) -> None:
        """Raise ParameterError while a job is running."""
        if self.job is not None and not self.is_free:
            raise ParameterError(f"{self.job.state.what} is running: wait for its end, or cancel it")

    def start(
        self,
        room: str,
        what: str,
        work: Callable[[Progress], T],
        then: Callable[[T], None],
        improved: Callable[[Found], None] = lambda _: None,
        patience: float = 0.0,
    ) -> None:
        """Start a long-running job in its own process. The job and its result must be picklable.

        `then(result)` and `improved(report)` are called in the session; after each call the tab is displayed again.
        `patience` is that of a job that moves an axis, in s; see `Job`.
        Raises ParameterError while another job is running.
        """
        self.check_free()
        self.job = self.begun(room, what, work, then, improved, patience)

    def cancel(self) -> None:
        """Cancel the running job, if any."""
        if self.job is not None:
            self.job.cancel()

    def job_state(self) -> JobState | None:
        """Return the state of the last job."""
        return None if self.job is None else self.job.state

    def close(self) -> None:
        """Stop the running job, and stop following live sources. Work that waits for the job's end is not started."""
        self.closed = True
        # a job that cannot be ended must not keep the sources of the page open
        with suppress(Exception):
            if self.job is not None:
                self.job.end()
        for close in self.closing:
            close()
