"""The judgments of all commands on their own results, with their exit codes; docs/reference/files.md lists them.

A judgment concerns the result, not the machine. It is bad if the result must not be used, or if the question remains
open. For a valid result that is unfavorable for the machine, such as chatter or a low yield, the judgment is good.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from feeddrive.language.text import Text


class Judgment(Enum):
    """A judgment of a command on its own result.

    commands   the commands that can return this judgment
    says       the phrase by which the sentence that states the judgment is recognized, at its start or within it
    exit_code  the exit code of the command line: 1 if the judgment is bad
    """

    DONE = "all others", "what was asked for is done", 0
    UNITS_IN_DOUBT = "frf, identify, friction, cogging", "Check the units before anything is done with these values", 1
    SCALES_IN_DOUBT = "identify", "Check clock and scales before anything is done with these values", 1
    INCOHERENT = "frf", "Do not tune on this response", 1
    USE_VALUES = "identify", "Use these values", 0
    DO_NOT_TUNE = "identify", "Do not tune on these values", 1
    DO_NOT_TRUST = "identify", "Measure once more before you trust these values", 1
    USE_MODEL = "identify", "Use this model", 0
    DO_NOT_USE_MODEL = "identify", "Do not use this model", 1
    MODEL_IS_OPEN = "identify", "Measure once more before you use this model", 1
    TAKE_CURVE = "friction", "Take", 0
    DO_NOT_USE_CURVE = "friction", "Do not use this curve", 1
    CURVE_IS_OPEN = "friction", "Measure more before you take this curve", 1
    TAKE_COGGING = "cogging", "Take order", 0
    NO_COGGING = "cogging", "Leave cogging out", 0
    COGGING_IS_OPEN = "cogging", "Measure the same travel the other way before you compensate anything", 1
    TAKE_TUNING = "tune", "all limits and all lines of the proof that could be checked hold", 0
    LEAVE_CONTROL = "tune", "Leave the control as it is", 0
    DO_NOT_USE_TUNING = "tune", "the tuning violates a limit or its proof failed; no machine file was written", 1
    FEWER_ARE_GOOD = (
        "tune --study",
        "fewer fresh machines are good than under today's control; no machine file was written",
        1,
    )
    TAKE_SCHEDULE = "travel", "the schedule keeps all limits", 0
    DO_NOT_USE_SCHEDULE = "travel", "the schedule does not keep its limits", 1
    TRAVEL_PROVEN = "travel --certify", "at every position from", 0
    TRAVEL_NOT_PROVEN = "travel --certify", "The travel is not proven", 1
    TRAVEL_UNDECIDED = "travel --certify", "The travel is undecided", 1
    BOX_PROVEN = "certify --box", "at every plant of the box", 0
    BOX_NOT_PROVEN = "certify --box", "The box is not proven", 1
    BOX_UNDECIDED = "certify --box", "The box is undecided", 1
    CORRECTED = "setpath", "The part is corrected", 0
    NOT_CORRECTED = "setpath", "No share of the correction is safe on every machine of the box", 1
    LEARNED = "setpath --from-log", "Learned from the log", 0
    RANKED = "compare", "has the least rope-snap error of all that are ranked", 0
    KEEP_GAINS = "compare", "Today's gains have the least rope-snap error of all that are ranked: keep them", 0
    NONE_RANKED = "compare", "No law that was tuned is ranked: nothing is recommended", 1
    SCORED = "benchmark", "nothing beats P-PI by 2 %", 0
    NO_PLACE = "benchmark", "No law that was named has a place", 1
    NONE_PLACED = "benchmark", "No law has a place on all plants", 1
    PLANNED = "plan", "every sample is proven to lie within the limits", 0
    NOT_PLANNED = "plan", "could not be proven to keep its limits, and no setpoints were written", 1
    RAN = "run, demo, cosimulate", "every law moved the axis to the end", 0
    TRIPPED = "run, demo, cosimulate", "a guard tripped: the figures of its law are not those of the whole motion", 1
    SWEPT = "sweep", "yields and figures, however low", 0
    NO_FIGURES = "sweep", "no variant has figures", 1
    STABLE_CUT = "lobes", "does not chatter", 0
    CHATTERS = "lobes", "chatters at", 0
    EXPORTED = "export", "the export is written, and its loop is stable with a margin", 0
    NEAR_UNSTABLE = "export", "Tune it before it moves an axis", 1
    NOT_DECIDED = "export", "whether the loop is stable was not decided", 1
    PROVEN = "check", "PROVEN", 0
    NOT_PROVEN = "check", "REFUSED", 1
    TOGETHER = "check --machine", "The files belong together", 0
    NOT_TOGETHER = "check --machine", "These files do not belong together", 1
    EQUAL = "verify", "EQUAL, bit for bit", 0
    NOT_EQUAL = "verify", "NOT EQUAL", 1
    CHANGED = "verify", "CHANGED SINCE THE EXPORT", 1
    COMMISSIONED = "commission", "The new control runs as predicted and is kept", 0
    NOT_COMMISSIONED = "commission", "The control before stays in place", 1
    WORKS = "doctor", "feeddrive works on this computer", 0
    DOES_NOT_WORK = "doctor", "feeddrive does not work on this computer", 1
    CLAIMS_HOLD = "reproduce", "all claims hold", 0
    CLAIM_FAILS = "reproduce", "DOES NOT HOLD", 1

    def __init__(self, commands: str, says: str, exit_code: int) -> None:
        self.commands, self.says, self.exit_code = commands, says, exit_code

    @property
    def bad(self) -> bool:
        """True if the result must not be used, or the question remains open."""
        return self.exit_code != 0

    def because(self, reason: str) -> Advice:
        """Return this judgment together with a sentence that states it and its reason."""
        return Advice(self, Text(f"{self.says}: {reason}."))


class Advice(NamedTuple):
    """A judgment, and a sentence that states it and its reason."""

    judgment: Judgment
    sentence: str
