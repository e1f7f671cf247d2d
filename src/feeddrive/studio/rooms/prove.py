"""The Prove page of the studio: certificate and circle test."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.studio.desk import Asked, Desk, Held, Room, Said, act, free_name
from feeddrive.studio.stability import example, proven
from feeddrive.studio.works import Shown, circle_shown, circled
from feeddrive.workflow.certify import CertifyRequest
from feeddrive.workflow.circle import CircleRequest

_MOST_ERROR = 500.0  # %; a plant with twice the gain is already 100 % away
_ERROR = 0.2  # share by which a model may be wrong, unless a person says otherwise


class Prove(Room):
    """The page for proofs of the current controller, and for the circle test on the machine."""

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
        words = {
            "ready": bool(axes),
            "axes": axes,
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

    def _put(self, name: str, held: Held, result: Shown) -> None:
        """Store a result as the latest one, replacing an earlier one of this name."""
        # removed first, so that a result that is replaced moves to the end
        self.shown.pop(name, None)
        self.shown[name] = held, result


def _alike(one: Shown, other: Shown) -> bool:
    """Return True if two circle tests have the same radius and plane, so that they can be overlaid."""
    first, second = one.result, other.result
    return first.radius == second.radius and first.circles[0].axes == second.circles[0].axes
