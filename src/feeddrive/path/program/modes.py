"""The modes that M70 and M73 save, and the blocks that restore them (M72, and the return of a subroutine)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from feeddrive.path.program import blocks
from feeddrive.path.program.state import BY_CODE, PATH_MODES, State


class Modes(NamedTuple):
    """The modes that M70 saves and M72 restores, as fields of `State`; lengths are in the unit that was chosen then."""

    inch: bool
    feed_mode: int
    feed: float
    speed: float
    spindle: int
    plane: int
    tool_offset: tuple[float, ...]
    system: int
    path_mode: str
    tolerance: float
    naive_tolerance: float
    incremental: bool
    arc_absolute: bool
    retract_to_r: bool
    mist: bool
    flood: bool
    feed_override: bool
    speed_override: bool
    adaptive_feed: bool
    feed_hold: bool

    @classmethod
    def of(cls, state: State) -> Modes:
        """Return the modes of a state."""
        modes = cls._make(getattr(state, name) for name in cls._fields)
        # the list goes on changing
        return modes._replace(tool_offset=tuple(state.tool_offset))

    def unit_line(self, state: State) -> str:
        """Return the block that restores the unit; empty if it is the same."""
        return "" if self.inch == state.inch else "G20" if self.inch else "G21"

    def lines(self, state: State) -> Iterator[str]:
        """Yield the blocks that restore what differs in a state, which has the unit already."""
        now = Modes.of(state)

        def changed(*names: str) -> bool:
            return any(getattr(self, name) != getattr(now, name) for name in names)

        words = list[str]()
        if changed("feed_mode"):
            words.append(f"G{self.feed_mode // 10}")
        if self.feed_mode != 930 and changed("feed_mode", "feed"):
            words.append(f"F{_word(self.feed)}")
        if changed("speed"):
            words.append(f"S{_word(self.speed)}")
        if changed("spindle"):
            words.append({0: "M5", 1: "M3", -1: "M4"}[self.spindle])
        if changed("plane"):
            words.append(f"G{self.plane // 10}")
        yield " ".join(words)
        if changed("tool_offset"):
            axes = zip(blocks.AXES, self.tool_offset, strict=True)
            yield (
                "G43.1 " + " ".join(f"{letter}{_word(value)}" for letter, value in axes)
                if any(self.tool_offset)
                else "G49"
            )
        if changed("system"):
            yield blocks.name_of("g", next(code for code, system in BY_CODE.items() if system == self.system))
        if changed("path_mode", "tolerance", "naive_tolerance"):
            tolerances = f" P{_word(self.tolerance)} Q{_word(self.naive_tolerance)}"
            code = {name: code for code, name in PATH_MODES.items()}[self.path_mode]
            yield blocks.name_of("g", code) + (tolerances if code == 640 else "")
        words = ["G91" if self.incremental else "G90"] if changed("incremental") else []
        words += ["G90.1" if self.arc_absolute else "G91.1"] if changed("arc_absolute") else []
        words += ["G99" if self.retract_to_r else "G98"] if changed("retract_to_r") else []
        yield " ".join(words)
        if now.mist > self.mist or now.flood > self.flood:
            # M9 ends both
            yield "M9"
            now = now._replace(mist=False, flood=False)
        yield from (code for code, name in (("M7", "mist"), ("M8", "flood")) if changed(name))
        switched = (("M50", "feed_override"), ("M51", "speed_override"), ("M52", "adaptive_feed"), ("M53", "feed_hold"))
        yield from (f"{code} P{int(getattr(self, name))}" for code, name in switched if changed(name))


def _word(value: float) -> str:
    # no exponent: RS-274 has none
    return f"{value:.17f}"
