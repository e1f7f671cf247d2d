"""What a frequency response is estimated from: input, output and what excited them, sampled on one clock."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from feeddrive.language.errors import LogError

FEWEST = 32  # samples
_STUCK = 0.02  # share of samples at the very largest or smallest value from which a channel counts as saturated


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """One measurement: `input` and `output` of shape (n,), each sample `sample_time` s after the one before.

    references  what was added from outside, shape (n,) each: the setpoint, or the force on top of the command.  In a
                closed loop nothing else tells what noise did and what the drive did
    Raises LogError for channels of different length, too short ones, constant ones, NaN, and an output that is the
    input.
    """

    input: np.ndarray
    output: np.ndarray
    sample_time: float
    references: tuple[np.ndarray, ...] = ()
    input_name: str = "input"
    output_name: str = "output"
    unit: str = ""
    name: str = "record"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise LogError(f"{self.name}: sample time {self.sample_time:g} s must be > 0 s")
        for name, values in self._channels():
            if values.ndim != 1 or values.size < FEWEST:
                raise LogError(
                    f"{self.name}: '{name}' of shape {values.shape} must be one row of {FEWEST} samples or more"
                )
            if values.size != np.size(self.output):
                raise LogError(f"{self.name}: '{name}' has {values.size} samples, the output {np.size(self.output)}")
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise LogError(
                    f"{self.name}: '{name}' is {values[bad[0]]} at sample {bad[0]} ({bad.size} such samples)"
                )
            if np.ptp(values) == 0.0:
                raise LogError(f"{self.name}: '{name}' is constant at {values[0]:g}: it holds nothing to measure by")
        if np.array_equal(self.input, self.output):
            raise LogError(
                f"{self.name}: input '{self.input_name}' and output '{self.output_name}' are the same numbers, whose "
                "response is 1: name two different columns"
            )
        for name in ("input", "output"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        object.__setattr__(self, "references", tuple(np.asarray(each, float) for each in self.references))

    def _channels(self) -> list[tuple[str, np.ndarray]]:
        named = [(self.input_name, self.input), (self.output_name, self.output)]
        named += [(f"reference {i + 1}", each) for i, each in enumerate(self.references)]
        return [(name, np.asarray(values, float)) for name, values in named]

    def __len__(self) -> int:
        return self.output.size

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """What may be wrong with the channels: saturation."""
        found: list[str] = []
        for name, values in self._channels()[:2]:
            for what, end in (("largest", np.max(values)), ("smallest", np.min(values))):
                share = float(np.mean(values == end))
                # quantised signals rest at their extremes for a while; a saturated one stays there in runs
                held = np.flatnonzero((values[1:] == end) & (values[:-1] == end)).size / values.size
                if share > _STUCK and held > 0.5 * share:
                    found.append(
                        f"{name} stays at its {what} value {end:.6g} for {100 * share:.1f} % of the record: it seems "
                        f"saturated, and a saturated drive has no frequency response"
                    )
        return tuple(found)

    @property
    def nyquist(self) -> float:
        """Hz."""
        return 0.5 / self.sample_time
