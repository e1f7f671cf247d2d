"""A sequence of references, one after another."""

from functools import cached_property
from itertools import accumulate

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.sampled import are_all, check_duration
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import part
from feeddrive.language.errors import StructureError


class Sequence(Reference):
    """References in sequence: each one begins at the time and the position at which the previous one ends.

        x(t) = rᵢ(t - tᵢ) - rᵢ(0) + x(tᵢ)   for tᵢ <= t < tᵢ₊₁,   tᵢ₊₁ = tᵢ + duration of rᵢ,   t₀ = 0,   x(0) = r₀(0)

    The first reference keeps its positions; each later one is shifted as a whole to start at the end of the previous
    one.  At the instant of a change, the next reference is active.  Nothing is blended: references at rest at both ends
    join smoothly.
    Raises StructureError for an empty sequence.
    """

    references: tuple[Reference, ...] = part("references in their order")

    def check(self) -> None:
        """Raise StructureError unless there is at least one reference."""
        if not are_all(self.references, Reference):
            raise StructureError("sequence.references must be a tuple of at least one reference, and of nothing else")
        check_duration(self.kind, self.duration)

    @cached_property
    def _starts(self) -> np.ndarray:
        """The start of each reference and the end of the last, s."""
        return np.array(list(accumulate((reference.duration for reference in self.references), initial=0.0)))

    @cached_property
    def _offsets(self) -> np.ndarray:
        """The position offset of each reference, m."""
        offsets = [0.0]
        for before, after in zip(self.references, self.references[1:], strict=False):
            # just after the end, where every reference rests at its last position
            end = np.asarray(before.at(np.array([np.nextafter(before.duration, np.inf)])).position)[0]
            start = np.asarray(after.at(np.zeros(1)).position)[0]
            offsets.append(offsets[-1] + float(end - start))
        return np.array(offsets)

    @property
    def duration(self) -> float:
        """The total duration of all references, s."""
        return float(self._starts[-1])

    def at(self, t: np.ndarray) -> Setpoint:
        """Return the setpoints of the reference that is active at each time t in s."""
        times = np.asarray(t, dtype=np.float64)
        running = np.clip(np.searchsorted(self._starts[:-1], times, side="right") - 1, 0, len(self.references) - 1)
        out = np.empty((5, *times.shape))
        for place, reference in enumerate(self.references):
            mine = running == place
            if np.any(mine):
                local = times[mine] - self._starts[place]
                # a difference of two times may be rounded below the duration: the end would be missed
                ended = np.where(times[mine] >= self._starts[place + 1], reference.duration, -np.inf)
                rows = np.stack(reference.at(np.maximum(local, ended)))  # type: ignore[arg-type]
                rows[0] += self._offsets[place]
                out[:, mine] = rows
        return Setpoint(*out)  # type: ignore[arg-type]
