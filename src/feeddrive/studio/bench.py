"""The bench: the axis that is tuned on the page, with its controller and its measured or modelled operating points."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from feeddrive.analysis.friction_map import FrictionMap
from feeddrive.blocks.families import Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.files.frf import FrfLike
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Units
from feeddrive.language.text import Text
from feeddrive.loop.box import AUTO, Box
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.plot.chart import Chart
from feeddrive.plot.identification import friction_chart
from feeddrive.plot.over_frequency import Overlay
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.closed_loop import through
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import READINGS, OperatingPoint, modelled_point, one_encoder
from feeddrive.workflow.command import AT_THE_MODEL, stem, told_apart
from feeddrive.workflow.control_text import machine_text
from feeddrive.workflow.tune import NO_MODEL
from feeddrive.workflow.tune_sources import Sources, first_control, points_of

AT_RESPONSES = "The limits hold for the measured responses, with their noise."
_SIGNALS = ("following_error", "force")
_REST = ("tracking_error", "force")  # of the rope snap


@dataclass(frozen=True, eq=False)
class Bench:
    """The axis tuned on a page, with its controllers and models.

    title         description for the user
    by_hand       the initial controller with its operating points
    sources       source files, as the tuner accepts them
    machine       machine file of the axis; for measured responses, that of the reference controller; None if there is
                  none
    axis          axis name in the machine file
    remarks       remarks on the measured responses
    today         reference controller, shown as `today`; None if it is the initial controller
    file          machine file as named by the user; empty if there is none
    friction      measured friction over velocity, if any
    from_machine  True if the operating points are models of machine files, False if measured
    """

    title: str
    by_hand: ByHand
    sources: Sources
    machine: MachineFile | None = None
    axis: str = ""
    remarks: tuple[str, ...] = ()
    today: ByHand | None = None
    from_machine: bool = True
    file: str | Path = ""
    friction: FrictionMap | None = None

    @property
    def before(self) -> ByHand:
        """The reference controller, which is shown as `today`, at the same operating points."""
        return self.today or self.by_hand

    def with_control(self, control: Control) -> Self:
        """Return the same axis with another initial controller and the same reference controller."""
        return replace(self, by_hand=ByHand(control, self.by_hand.points, self.by_hand.limits), today=self.before)

    @property
    def loop(self) -> Loop | None:
        """The loop of the axis with the reference controller, from the machine file; None without such a file."""
        return None if self.machine is None else self.machine.loops[self.axis]

    def over(self, box: str) -> Text:
        """Return in words which plants a value of the option --box means on this axis.

        Raises ParameterError for a text that is none.
        """
        if self.machine is None:
            # an unknown text is refused here as well
            return Text(AT_RESPONSES if Box.parse(box) is None or box.strip() == AUTO else NO_MODEL)
        found = self.machine.box(box, self.axis)
        if found is None or (not self.from_machine and box.strip() == AUTO):
            return Text(AT_THE_MODEL if self.from_machine else AT_RESPONSES)
        return Text(f"Limits hold at all plants of the box: {found.text(self.needed_loop().axis)}.")

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.loop is not None and self.loop.axis.rotary

    def needed_loop(self) -> Loop:
        """Return the loop. Raise ParameterError with a remedy for measured responses if there is no machine."""
        if self.loop is None:
            raise ParameterError(
                "a measured response alone moves no axis: import today's machine file too, or identify one from it"
            )
        return self.loop

    @cached_property
    def duty(self) -> Duty:
        """The duty with which laws are compared on this axis. Raises ParameterError if there is no machine."""
        return duty_of(self.needed_loop(), None, None)

    @cached_property
    def work(self) -> tuple[Reference, StepForce, float]:
        """The set motion, the force pulse on the table after it, and the duration (s), within the machine's limits."""
        duty = self.duty
        pause = max(0.25 * duty.move.duration, 0.05)
        begin = duty.move.duration + pause
        return duty.move, StepForce(force=duty.force, start=begin, end=begin + pause), begin + 2.0 * pause

    def run(self, control: Control, name: str) -> Run:
        """Simulate the move and the force pulse of `work` with a controller, with friction, quantization and limits.

        Raises DivergedError if the axis leaves its bounds, ParameterError if there is no machine.
        """
        reference, load, duration = self.work
        loop = replace(self.needed_loop(), control=control)
        # only the signals that are drawn: a run has some 70,000 samples
        return simulate(loop, reference, load=load, duration=duration, record=_SIGNALS, name=name)

    def snap(self, control: Control, name: str) -> Run:
        """Simulate the rope-snap test with a controller: a force acts on the table at rest until `duty.begin`.

        Raises DivergedError if the axis leaves its bounds, ParameterError if there is no machine.
        """
        duty, loop = self.duty, replace(self.needed_loop(), control=control)
        duration = duty.begin + duty.rest
        return simulate(loop, duty.still(), load=duty.snap, duration=duration, record=_REST, name=name)

    def linear(self, control: Control) -> StateSpace:
        """Return the linear loop from the set position to the table. Raises ParameterError if there is no machine."""
        return linearize(replace(self.needed_loop(), control=control), ["set_position"], ["position_load"])

    @cached_property
    def mechanics(self) -> StateSpace:
        """The linearized axis without control, from the command to both readings.

        Raises ParameterError if there is no machine.
        """
        return linearize(self.needed_loop(), ["cut"], READINGS)

    def overlays(self, place: str) -> tuple[Overlay, ...]:
        """Return the responses of the axis to the command at one operating point: measured, modelled, or both."""
        if place not in self._overlays:
            self._overlays[place] = tuple(self._overlaid(next(p for p in self.by_hand.points if p.name == place)))
        return self._overlays[place]

    def friction_shown(self, units: Units) -> Chart | None:
        """Return the chart of modelled and measured friction versus velocity; None if there is no machine."""
        if self.loop is None:
            return None
        if units not in self._frictions:
            self._frictions[units] = friction_chart(self.loop, measured=self.friction, units=units)
        return self._frictions[units]

    # the dataclass is frozen, so caches that grow are cached properties
    @cached_property
    def _frictions(self) -> dict[Units, Chart]:
        return {}

    @cached_property
    def _overlays(self) -> dict[str, tuple[Overlay, ...]]:
        return {}

    def _overlaid(self, point: OperatingPoint) -> Iterator[Overlay]:
        f, loop = point.frequency, point.loop or self.loop
        model = None if loop is None else linearize(loop, ["cut"], READINGS)
        for k, reading in enumerate(READINGS):
            # with one encoder both readings have the same response
            if k == 0 and one_encoder(point):
                continue
            # a sampled model has no response above its Nyquist frequency
            own = None if model is None else model.response(f[f <= 0.5 / model.sample_time], reading, "cut")
            measured = None
            if not self.from_machine:
                variance = None if point.variance is None else through(point, 0, np.eye(2)[[k]].T * np.ones(f.size))
                T, coherence = point.sample_time, point.coherence
                measured = FRF(f, point.by_force[k], "force", reading, "m/N", T, coherence, variance)
            # an error between measurement and model needs both on the same lines
            same = own is not None and own.frequency.size == f.size
            yield Overlay(reading.replace("_", " of the "), measured, own if same else None, own)

    def text(self, values: Mapping[str, float]) -> str:
        """Return the content of the machine file with changed controller parameters; everything else is unchanged."""
        self.needed_loop()
        assert self.machine is not None
        return with_origins(machine_text(self.machine, self.axis, self.by_hand.control(values)), (self.machine,))


def bench_of(
    machine: MachineLike,
    axis: str | None = None,
    limits: Limits | None = None,
    at: Sequence[MachineLike] = (),
) -> Bench:
    """Return the bench of an axis of a machine file.

    at  machine files of the same axis at other positions or loads

    Raises the errors of `read_machine`, and ParameterError for an unknown axis.
    """
    file = read_machine(machine)
    name = file.named(axis)
    loop = file.loops[name]
    files = [file, *map(read_machine, at)]
    names = told_apart((other.name, stem(other)) for other in files)
    loops = [loop, *(other.loop(axis or name) for other in files[1:])]
    points = [
        # one control for all positions, whatever gains the other files hold
        modelled_point(replace(modelled, control=loop.control), named)
        for modelled, named in zip(loops, names, strict=True)
    ]
    by_hand = ByHand(loop.control, points, limits)
    return Bench(
        f"{file.name}, axis {name}", by_hand, Sources(machine, tuple(at), name), file, name, file=_named(machine)
    )


def bench_of_responses(
    source: FrfLike,
    *,
    at: Sequence[FrfLike] = (),
    motor: str | None = None,
    baseline: MachineLike | None = None,
    axis: str | None = None,
    unit: str | None = None,
    sample_time: float | None = None,
    delay: float = 0.0,
    limits: Limits | None = None,
) -> Bench:
    """Return the bench of measured responses.

    The reference controller is that of the machine file `baseline`, or a robustly tuned P-PI without such a file.
    Raises ParameterError with a remedy for inconsistent inputs.
    """
    machine = None if baseline is None else read_machine(baseline)
    name = "" if machine is None else machine.named(axis)
    loop = None if machine is None else machine.loops[name]
    sources = Sources(
        source,
        tuple(at),
        name or None,
        () if motor is None else (motor,),
        unit=unit,
        sample_time=sample_time,
        delay=delay,
    )
    points, remarks = points_of(sources, loop, Progress())
    control, begun = first_control(None, loop, points)
    measured = [point for point in points if isinstance(point, OperatingPoint)]
    all_remarks = [*remarks, *([f"to begin with: {begun}"] if begun else [])]
    title = Path(str(source)).name + ("" if machine is None else f", {machine.name}, axis {name}")
    return Bench(
        title,
        ByHand(control, measured, limits),
        sources,
        machine,
        name,
        tuple(all_remarks),
        from_machine=False,
        file=_named(baseline or ""),
    )


def _named(machine: MachineLike) -> str | Path:
    """Return the path of a machine file or the name of a bundled machine, as it is written in commands."""
    return machine.file.name if isinstance(machine, MachineFile) else machine
