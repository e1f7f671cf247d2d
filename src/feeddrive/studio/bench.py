"""What is tuned on the page: an axis at one or more operating points, and today's control of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from feeddrive.blocks.families import Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.comparison.figures import duty_of
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.workflow.tune_files import machine_text

_SIGNALS = ("following_error", "force", "tracking_error")


@dataclass(frozen=True, eq=False)
class Bench:
    """An axis of a machine file.

    machine, axis  the file and the name of the axis
    by_hand        its control at its operating points
    """

    machine: MachineFile
    axis: str
    by_hand: ByHand

    @property
    def loop(self) -> Loop:
        """Axis and today's control."""
        return self.machine.loops[self.axis]

    @property
    def title(self) -> str:
        """Machine and axis."""
        return f"{self.machine.name}, axis {self.axis}"

    @cached_property
    def _work(self) -> tuple[Reference, StepForce, float]:
        """A move and then a force on the table that comes and goes, within the limits of the machine; how long, s."""
        duty = duty_of(self.loop, None, None)
        pause = max(0.5 * duty.move.duration, 0.05)
        begin = duty.move.duration + pause
        return duty.move, StepForce(force=duty.force, start=begin, end=begin + pause), begin + 2.0 * pause

    def run(self, values: Mapping[str, float], name: str) -> Run:
        """The move and the force under the control at some values, with friction, counts and limits.

        Raises DivergedError if the axis leaves its bounds.
        """
        reference, load, duration = self._work
        loop = replace(self.loop, control=self.by_hand.control(values))
        return simulate(loop, reference, load=load, duration=duration, record=_SIGNALS, name=name)

    def text(self, values: Mapping[str, float]) -> str:
        """The machine file with the control at some values; all else as it is written there."""
        return machine_text(self.machine, self.axis, self.by_hand.control(values))


def bench_of(machine: MachineLike, axis: str | None = None, limits: Limits | None = None) -> Bench:
    """The bench of an axis of a machine file. Raises the errors of `read_machine`, ParameterError for the axis."""
    file = read_machine(machine)
    name = file.named(axis)
    loop = file.loops[name]
    return Bench(file, name, ByHand(loop.control, [modelled_point(loop, f"axis {name}")], limits))
