"""The control of now is proven: a certificate, the circle test, and a part program on the machine."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from feeddrive.files.machine import BUNDLED
from feeddrive.files.toml_values import quoted
from feeddrive.language.errors import ParameterError
from feeddrive.studio.desk import Desk, Held, free_name
from feeddrive.studio.recipe import whole
from feeddrive.studio.room import Asked, Room, Said, act
from feeddrive.studio.works import Shown, certified, circle_shown, circled, program_run
from feeddrive.workflow.certify import CertifyRequest
from feeddrive.workflow.circle import CircleRequest
from feeddrive.workflow.run_job import RunRequest

_PROGRAM = "a part program, beside its job"
_RULE = "the control that was tuned on the page"


class Prove(Room):
    """What is proven of the control of now, and what it does on the machine."""

    name = "prove"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Forget what was shown of another axis."""
        self.shown: dict[str, tuple[Held, Shown]] = {}
        self.circles: tuple[tuple[Held, Shown], ...] = ()  # that of another control before, and the latest

    def show(self) -> Said:
        """What can be proven, and what came out."""
        bench = self.desk.bench
        axes = [] if bench is None or bench.machine is None else list(bench.machine.loops)
        programs = [*_bundled(), *self.desk.programs]
        words = {
            "ready": bool(axes),
            "axes": axes,
            "programs": programs,
            "shown": {name: self.desk.said_of(held, each.words) for name, (held, each) in self.shown.items()},
        }
        charts = {f"{name}.{key}": chart for name, (_, of) in self.shown.items() for key, chart in of.charts.items()}
        return Said(words, charts)

    @act
    def certify(self, _: Asked) -> None:
        """Prove the loop stable for plants around the model."""
        bench = self.desk.needed
        bench.needed_loop()
        request = CertifyRequest(self.desk.machine_path(), axis=bench.axis, out=self.desk.folder / "certificate")
        held = self.desk.held()

        def then(found: Shown) -> None:
            self.desk.did("certify", request, held.control)
            self._put("certificate", held, found)

        self.desk.start(self.name, "certify", partial(certified, request), then)

    @act
    def circle(self, asked: Asked) -> None:
        """The circle test on the simulated machine, with the axes that are named."""
        machine = self.desk.needed.machine
        if machine is None or len(machine.loops) < 2:
            raise ParameterError("a circle needs a machine with two axes, and this one has fewer")
        x, y = asked.choice("x", machine.loops), asked.choice("y", machine.loops)
        out = free_name(self.desk.folder, "circle")
        request = CircleRequest((Path(self.desk.machine_path()),), x=x, y=y, out=out)
        held = self.desk.held()

        def then(found: Shown) -> None:
            self.desk.did("circle", request, held.control)
            alike = [each for each in self.circles if not each[0].same(held) and _alike(each[1], found)]
            self.circles = (*alike[-1:], (held, found))
            before = None if len(self.circles) < 2 else self.circles[0][1].result
            self._put("circle", held, circle_shown(found, before))

        self.desk.start(self.name, "circle test", partial(circled, request), then)

    @act
    def program(self, asked: Asked) -> None:
        """A part program on the machine: one that was brought, or a bundled one."""
        bench = self.desk.needed
        bench.needed_loop()
        name = asked.choice("name", [*_bundled(), *self.desk.programs])
        self.desk.check_free()
        source = self.desk.programs.get(name) or BUNDLED / "programs" / name
        part = self.desk.keep(Path(name).name, source.read_bytes(), _PROGRAM)
        machine = quoted(whole(self.desk.machine_path()))
        text = [
            f"title = {quoted(f'{name} on {bench.title}')}",
            f"machine = {machine}",
            f"axis = {quoted(bench.axis)}",
            f"rule = {quoted(_RULE)}",
            "",
            "[program]",
            f"file = {quoted(part.name)}",
            "",
        ]
        job = self.desk.keep("job.toml", "\n".join(text).encode(), f"the job of {part.name}, which stands beside it")
        request = RunRequest(str(job), out=free_name(self.desk.folder, "run"))
        held = self.desk.held()

        def then(found: Shown) -> None:
            self.desk.did("run", request, held.control)
            self._put("program", held, found)

        self.desk.start(self.name, f"run {name}", partial(program_run, request), then)

    def _put(self, name: str, held: Held, found: Shown) -> None:
        """What was shown last stands behind what was shown before."""
        self.shown.pop(name, None)
        self.shown[name] = held, found


def _alike(one: Shown, other: Shown) -> bool:
    """Whether two circle tests have the same radius and plane, so that one may be drawn over the other."""
    first, second = one.result, other.result
    return first.radius == second.radius and first.circles[0].axes == second.circles[0].axes


def _bundled() -> list[str]:
    return sorted(each.name for each in (BUNDLED / "programs").glob("*.ngc"))
