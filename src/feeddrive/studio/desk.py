"""What the rooms of one page share: the source that is worked on, the numbers of its control now, and what was done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from feeddrive.files.atomic_io import write_whole
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio.jobs import Found, Job, JobState
from feeddrive.workflow.adjust import AdjustRequest

if TYPE_CHECKING:
    from feeddrive.files.machine import MachineFile
    from feeddrive.loop.control import Control
    from feeddrive.studio.bench import Bench
    from feeddrive.workflow.request import Request

T = TypeVar("T")
Values = dict[str, float]
_UNDONE = 200  # steps that are kept


@dataclass(frozen=True)
class Step:
    """One thing that was done: a command of the workflow with its request."""

    command: str
    request: Request


class Desk:
    """The state of one page. It is not shared: what one page moves, no other one sees.

    folder    its own: what was brought stands in `brought`, results beside it
    bench     what is tuned; None before something was brought
    brought   files that were named at the start of the command, and stand elsewhere
    epoch     counts the sources
    base      machine file with the control to begin with
    programs  part programs that were brought, by name
    done      what was done since the source was brought
    """

    def __init__(self, folder: Path, brought: tuple[Path, ...] = ()) -> None:
        self.folder, self.brought = folder, brought
        self.bench: Bench | None = None
        self.epoch = 0
        self.base: str | Path = ""
        self.values: Values = {}
        self.programs: dict[str, Path] = {}
        self.done: list[Step] = []
        self.job: Job | None = None
        self.undo: list[Values] = []
        self.redo: list[Values] = []
        self._begins = True  # whether the next change is a step of its own, and not one more of a drag
        self.changed: Callable[[], None] = lambda: None  # set by the session: another source
        self.tell: Callable[[str], None] = lambda _: None  # set by the session: show a room again
        self.begun: Callable[[str, str, Callable[[Progress], Any], Callable[[Any], None], Callable[[Found], None]], Job]

    def put(self, bench: Bench, *, same: bool = False) -> None:
        """Work on another source: all rooms begin anew. Raises ParameterError while a job runs.

        same  it is the same axis with a control of other parts: what was done with it stays
        """
        self.check_free()
        self.bench, self.epoch = bench, self.epoch + 1
        self.values = bench.by_hand.values
        self.base = self._kept(bench) if same else bench.file
        self.undo, self.redo, self.done = [], [], self.done if same else []
        self._begins = True
        self.changed()

    def _kept(self, bench: Bench) -> str | Path:
        """A machine file with a control that was found, for what is done next."""
        if bench.machine is None:
            return bench.file
        path = self.folder / f"begun_{self.epoch}.toml"
        write_whole(path, bench.text(self.values))
        return path

    @property
    def needed(self) -> Bench:
        """The bench. Raises ParameterError before something was brought."""
        if self.bench is None:
            raise ParameterError("there is no axis yet: bring a machine file, a log or a frequency response first")
        return self.bench

    def change(self, wanted: Mapping[str, float], *, begins: bool = True) -> None:
        """Other numbers; of a drag only the first change `begins` a step to undo. Raises ParameterError for bounds."""
        self.needed.by_hand.control(wanted)
        self._begins = self._begins or begins
        if dict(wanted) == self.values:
            return
        if self._begins:
            self.undo = [*self.undo, self.values][-_UNDONE:]
            self.redo.clear()
        self.values, self._begins = dict(wanted), False

    def back(self) -> None:
        """Undo a step, if there is one."""
        self._swap(self.undo, self.redo)

    def again(self) -> None:
        """Redo a step, if one was undone."""
        self._swap(self.redo, self.undo)

    def _swap(self, source: list[Values], other: list[Values]) -> None:
        if source:
            other.append(self.values)
            self.values, self._begins = source.pop(), True

    def did(self, command: str, request: Request) -> None:
        """Keep what was done, for those who want it as commands."""
        self.done.append(Step(command, request))

    def take(self, control: Control) -> None:
        """Go on with a control that was found: a step that can be undone, if it has the same parts as that of now."""
        bench = self.needed
        names = {each.name for each in bench.by_hand.knobs}
        found = {name: value for name, value in tree.leaves(control) if name in names}
        if found.keys() == names and bench.by_hand.control(found) == control:
            self.change({name: float(value) for name, value in found.items()})
        else:
            self.put(bench.with_control(control), same=True)

    @property
    def changes(self) -> Values:
        """Numbers that differ from those of the control to begin with."""
        begun = self.needed.by_hand.values
        return {name: value for name, value in self.values.items() if value != begun[name]}

    def adjusted(self) -> AdjustRequest | None:
        """What writes the control of now into the machine file to begin with; None if nothing was moved.

        Raises ParameterError without a machine.
        """
        bench = self.needed
        bench.needed_loop()
        pairs = tuple(f"{name}={value!r}" for name, value in self.changes.items())
        if not pairs:
            return None
        return AdjustRequest(self.base, set=pairs, axis=bench.axis, out=self.folder / "machine.toml")

    def machine_path(self) -> str | Path:
        """A machine file with the control of now: that to begin with, or one that is written into the folder.

        Raises ParameterError without a machine.
        """
        request = self.adjusted()
        if request is None:
            return self.base
        path = self.folder / "machine.toml"
        write_whole(path, self.needed.text(self.values))
        known = [each.request for each in self.done if each.command == "adjust"]
        if not known or known[-1] != request:
            self.did("adjust", request)
        return path

    def machine(self) -> MachineFile:
        """The machine with the control of now."""
        from feeddrive.files.machine import read_machine

        return read_machine(self.machine_path())

    def check_free(self) -> None:
        """Raise ParameterError while a job runs."""
        if self.job is not None and self.job.state.going:
            raise ParameterError(f"{self.job.state.what} is running: wait for its end, or cancel it")

    def start(
        self, room: str, what: str, work: Callable[[Progress], T], then: Callable[[T], None],
        found: Callable[[Found], None] = lambda _: None,
    ) -> None:  # fmt: skip
        """Begin a long work in a process of its own: `work` and what it gives can be pickled.

        `then(result)` and `found(report)` are called in the session; after each the room is shown again. Raises
        ParameterError while another job runs.
        """
        self.check_free()
        self.job = self.begun(room, what, work, then, found)

    def cancel(self) -> None:
        """Stop the job, if one runs."""
        if self.job is not None:
            self.job.cancel()

    def job_state(self) -> JobState | None:
        """Of the last job."""
        return None if self.job is None else self.job.state

    def close(self) -> None:
        """End what runs."""
        with suppress(Exception):
            if self.job is not None:
                self.job.kill()
