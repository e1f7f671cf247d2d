"""The Prove page of the studio: certificate, circle test, and a part program that is run or corrected."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

from feeddrive.files.machine import BUNDLED, MachineFile
from feeddrive.files.toml_file import quoted
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.studio.desk import Asked, Desk, Held, Room, Said, act, free_name
from feeddrive.studio.rooms.export import whole
from feeddrive.studio.stability import example, proven
from feeddrive.studio.works import Shown, circle_shown, circled, part_corrected, program_run
from feeddrive.workflow.certify import CertifyRequest
from feeddrive.workflow.circle import CircleRequest
from feeddrive.workflow.run_job import RunRequest
from feeddrive.workflow.setpath import SetpathRequest

_PROGRAM = "a part program, beside its job"
_MOVES_TIP = re.compile(r"^G43\.[45]", re.MULTILINE)
_RULE = "the control that was tuned on the page"
_MOST_ERROR = 500.0  # %; a plant with twice the gain is already 100 % away
_ERROR = 0.2  # share by which a model may be wrong, unless a person says otherwise


class Prove(Room):
    """The page for proofs of the current controller and for simulations on the machine."""

    name = "prove"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    def begin(self) -> None:
        """Discard the results of the previous axis."""
        self.shown: dict[str, tuple[Held, Shown]] = {}
        self.circles: tuple[tuple[Held, Shown], ...] = ()  # that of another control before, and the latest
        self.error = _ERROR

    def show(self) -> Said:
        """Return the available proofs and the results."""
        bench = self.desk.bench
        axes = [] if bench is None or bench.machine is None else list(bench.machine.loops)
        programs = [*_bundled(None if bench is None else bench.machine), *self.desk.programs]
        words = {
            "ready": bool(axes),
            "axes": axes,
            "programs": programs,
            "model_error": 100.0 * self.error,
            "shown": {name: self.desk.said_of(held, result.words) for name, (held, result) in self.shown.items()},
        }
        charts = {f"{name}.{key}": chart for name, (_, of) in self.shown.items() for key, chart in of.charts.items()}
        if "certificate" not in self.shown:
            words["example"], pictures = example()
            charts |= {f"example.{key}": chart for key, chart in pictures.items()}
        return Said(words, charts)

    @act
    def certify(self, asked: Asked) -> None:
        """Prove that the loop is stable for all plants around the model, which may be wrong by `model_error` %."""
        bench = self.desk.needed
        loop = bench.needed_loop()
        error = asked.number_or_none("model_error")
        if error is not None and not 0.0 < error <= _MOST_ERROR:
            raise ParameterError(
                f"the model may be wrong by more than 0 and at most {_MOST_ERROR:g} %, not by {error:.4g} %"
            )
        self.error = self.error if error is None else units.rounded(0.01 * error, 6)
        request = CertifyRequest(
            self.desk.machine_path(),
            axis=bench.axis,
            radius=None if self.error == _ERROR else self.error,
            out=self.desk.folder / "certificate",
        )
        # the control may change while the job runs: the result belongs to the one at its start
        held = self.desk.held()

        # the axis as it is tuned, and with the gains that it had
        controls = {"Now": held.control, "Today": bench.before.start}
        loops = {name: replace(loop, control=control) for name, control in controls.items()}

        def then(shown: Shown) -> None:
            if shown.words["proof"]["proven"]:
                self.desk.did("certify", request, held.control)
            self._put("certificate", held, shown)

        self.desk.start(self.name, "prove stability", partial(proven, request, loops), then)

    @act
    def circle(self, asked: Asked) -> None:
        """Run the circle test on the simulated machine, with the named axes."""
        machine = self.desk.needed.machine
        if machine is None or len(machine.loops) < 2:
            raise ParameterError("a circle needs a machine with two axes, and this one has fewer")
        x, y = asked.choice("x", machine.loops), asked.choice("y", machine.loops)
        out = free_name(self.desk.folder, "circle")
        request = CircleRequest((Path(self.desk.machine_path()),), x=x, y=y, out=out)
        held = self.desk.held()

        def then(shown: Shown) -> None:
            self.desk.did("circle", request, held.control)
            # circles of another radius or plane cannot be drawn over these
            alike = [circle for circle in self.circles if not circle[0].same(held) and _alike(circle[1], shown)]
            self.circles = (*alike[-1:], (held, shown))
            before = None if len(self.circles) < 2 else self.circles[0][1].result
            self._put("circle", held, circle_shown(shown, before))

        self.desk.start(self.name, "circle test", partial(circled, request), then)

    @act
    def program(self, asked: Asked) -> None:
        """Run an uploaded or bundled part program on the machine."""
        name, job = self._job(asked)
        request = RunRequest(str(job), out=free_name(self.desk.folder, "run"))
        held = self.desk.held()

        def then(shown: Shown) -> None:
            self.desk.did("run", request, held.control)
            self._put("program", held, shown)

        self.desk.start(self.name, f"run {name}", partial(program_run, request), then)

    @act
    def correct(self, asked: Asked) -> None:
        """Correct a part program by its plan: setpoints and force offsets, judged on a box of machines."""
        name, job = self._job(asked)
        request = SetpathRequest(str(job), out=free_name(self.desk.folder, "setpath"))
        held = self.desk.held()

        def then(shown: Shown) -> None:
            self.desk.did("setpath", request, held.control)
            self._put("corrected", held, shown)

        self.desk.start(self.name, f"correct {name}", partial(part_corrected, request), then)

    def _job(self, asked: Asked) -> tuple[str, Path]:
        """Return the name of the chosen part program, and a job that runs it under the current controller."""
        bench = self.desk.needed
        bench.needed_loop()
        name = asked.choice("name", [*_bundled(bench.machine), *self.desk.programs])
        self.desk.check_free()
        source = self.desk.programs.get(name) or BUNDLED / "programs" / name
        # a copy beside the job, which then names it without a folder
        part = self.desk.keep(Path(name).name, source.read_bytes(), _PROGRAM)
        text = [
            # names come from uploads: quoted, they cannot add keys to the job
            f"title = {quoted(f'{name} on {bench.title}')}",
            f"machine = {quoted(whole(self.desk.machine_path()))}",
            f"axis = {quoted(bench.axis)}",
            f"rule = {quoted(_RULE)}",
            "",
            "[program]",
            f"file = {quoted(part.name)}",
            "",
        ]
        job = self.desk.keep("job.toml", "\n".join(text).encode(), f"the job of {part.name}, which stands beside it")
        return name, job

    def _put(self, name: str, held: Held, result: Shown) -> None:
        """Store a result as the latest one, replacing an earlier one of this name."""
        # removed first, so that a result that is replaced moves to the end
        self.shown.pop(name, None)
        self.shown[name] = held, result


def _alike(one: Shown, other: Shown) -> bool:
    """Return True if two circle tests have the same radius and plane, so that they can be overlaid."""
    first, second = one.result, other.result
    return first.radius == second.radius and first.circles[0].axes == second.circles[0].axes


def _bundled(machine: MachineFile | None) -> list[str]:
    """Return the bundled part programs for a machine: those that move the tip of the tool need its kinematics."""
    paths = (BUNDLED / "programs").glob("*.ngc")
    five = machine is not None and machine.kinematics is not None
    return sorted(path.name for path in paths if five or not _MOVES_TIP.search(path.read_text(encoding="utf-8")))
