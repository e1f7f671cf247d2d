"""The guided tour: step-by-step instructions from a log to an exported controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from feeddrive.studio.desk import Asked, Desk, Room, Said, act

TITLE = "Tour: your axis in ten minutes"


@dataclass(frozen=True)
class Step:
    """A step of the tour.

    title, text  title, and two sentences: what to look at, and which button to press next
    room         name of the tab in which the step takes place
    marked       ids of the page elements to look at and to press, in this order
    act          action of the page that completes the step, if any
    command      workflow command whose completion completes the step, if any; otherwise the button Next completes it
    """

    title: str
    text: str
    room: str
    marked: tuple[str, ...] = ()
    act: str = ""
    command: str = ""


STEPS = (
    Step(
        "A log",
        "This log of three strokes was simulated from the bundled ball screw, with a workpiece on the table of which "
        "the machine file knows nothing. Look at what each column was taken for and why, and press Next.",
        "import",
        ("columns-of-log", "tour-next"),
    ),
    Step(
        "Identify",
        "The known machine has the gains that ran; ball screw (bundled) is chosen already. Press Identify axis, which "
        "takes about ten seconds.",
        "import",
        ("identify",),
        command="identify",
    ),
    Step(
        "Model over measurement",
        "The picture lays the model over the log, and mass_load shows that the workpiece of 12 kg was found on top of "
        "the 33 kg of the file. Press Tune this axis.",
        "import",
        ("take-identified",),
        act="import.take",
    ),
    Step(
        "Today's control",
        "The sentence above the pictures says that Ms, the peak of the sensitivity, breaks its limit with this "
        "workpiece; drag a slider, see all pictures follow, and press Undo. Then open Optimize.",
        "tune",
        ("tab-optimize",),
        act="optimize.show",
    ),
    Step(
        "A goal",
        "So that the axis does not become softer, write 6.25 into Least stiffness, or drag the line of the dynamic "
        "stiffness up to there. Then press Start, and watch the search.",
        "optimize",
        ("optimize-field-max_compliance", "tune-start"),
        command="tune",
    ),
    Step(
        "What was found",
        "The sentence at the top says what gets worse first, and each picture has today's control beside what was "
        "found. Press Use result to go on with it.",
        "optimize",
        ("optimize-accept",),
        act="optimize.accept",
    ),
    Step(
        "Before and after",
        "All limits hold now; look at today and now in each picture, the simulated move with friction and counts among "
        "them. Then open Prove.",
        "tune",
        ("tab-prove",),
        act="prove.show",
    ),
    Step(
        "A proof",
        "A certificate proves the loop stable for each plant in a disc around the model. Press Prove this loop.",
        "prove",
        ("prove-certify",),
        command="certify",
    ),
    Step(
        "What is proven",
        "Proven or not stands at the top, with the distance; read below the pictures what the proof covers and what it "
        "does not. Then open Export.",
        "prove",
        ("tab-export",),
        act="export.show",
    ),
    Step(
        "Export",
        "Each target gets a control that equals the simulation in every bit. Press C source.",
        "export",
        ("export-target-c",),
        command="export",
    ),
    Step(
        "Your control",
        "Download the archive, in which the control stands in C with a test; below it the whole tour stands as "
        "commands, as Python and as a job. Press End, and import a log of your own.",
        "export",
        ("export-archive-c", "tour-next"),
    ),
)


class Tour(Room):
    """The guided tour. It has no tab: its panel is shown above all tabs."""

    name = "tour"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.at: int | None = None  # the step; None: there is no tour
        self._before = 0  # how often its command had been done before it

    @property
    def words(self) -> dict[str, Any] | None:
        """The current step for the page; None if there is no tour."""
        # every message has the current step, also those that a finished job sends
        self._follow()
        if self.at is None:
            return None
        step = STEPS[self.at]
        return {
            "label": TITLE,
            "number": self.at + 1,
            "of": len(STEPS),
            "title": step.title,
            "text": step.text,
            "room": step.room,
            "marked": step.marked,
            "next": "Next" if self.at + 1 < len(STEPS) else "End",
        }

    def heard(self, act: str) -> None:
        """Handle an action of the page: start the tour, or complete a step."""
        if act == "import.tour":
            self._go(0)
        elif self.at is not None and STEPS[self.at].act == act:
            self._go(self.at + 1)

    @act
    def next(self, _: Asked) -> None:
        """Go to the next step, even if the present one is not completed; end the tour after the last one."""
        if self.at is not None:
            self._go(self.at + 1)

    @act
    def back(self, _: Asked) -> None:
        """Go back one step."""
        if self.at:
            self._go(self.at - 1)

    @act
    def leave(self, _: Asked) -> None:
        """End the tour; the results are kept."""
        self.at = None

    def show(self) -> Said:
        """Return an empty response, since the step is part of every message."""
        return Said()

    def _go(self, at: int) -> None:
        self.at = at if at < len(STEPS) else None
        # the command may have been run before the tour reached its step
        self._before = self._done()

    def _done(self) -> int:
        """Count the completed runs of the current step's command."""
        wanted = "" if self.at is None else STEPS[self.at].command
        return sum(1 for step in self.desk.done if step.command == wanted)

    def _follow(self) -> None:
        """Go to the next step if the command of the present one has finished."""
        done = self._done()
        if done > self._before and self.at is not None:
            self._go(self.at + 1)
        # another source starts with no completed commands
        self._before = min(self._before, done)
