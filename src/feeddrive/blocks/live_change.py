"""The state of a block after its parameters change in a running loop: `retune`.

There is no default for a block with a state.  The old state is right only where no parameter scales what it holds, and
a state that is continuous for any block does not exist: the last output fixes one number of several.
"""

from __future__ import annotations

from typing import Any, ClassVar

from feeddrive.language import tree
from feeddrive.language.errors import StructureError


class Retuned:
    """A block of a control with prepared numbers."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any, old_prepared: Any, prepared: Any) -> Any:
        """Return the state after a live change from the block `old` to this one, without a bump (hook; without it a
        block with a state raises StructureError).
        """
        return _without_numbers(self.kind, state, "state, old, old_prepared, prepared")


class RetunedUnprepared:
    """A block of a control without prepared numbers."""

    kind: ClassVar[str]

    def retune(self, state: Any, old: Any) -> Any:
        """Return the state after a live change from the block `old` to this one, without a bump (hook; without it a
        block with a state raises StructureError).
        """
        return _without_numbers(self.kind, state, "state, old")


def _without_numbers(kind: str, state: Any, arguments: str) -> Any:
    held = [name or "a number" for name, _ in tree.leaves(state)]
    if held:
        raise StructureError(
            f"{kind} does not say what becomes of its state ({', '.join(held[:3])}{', ...' if held[3:] else ''}) when "
            f"its parameters change in a running loop: define retune(self, {arguments}), which returns the state with "
            f"which the output goes on: `return state` where no parameter scales what it holds, as positions in m and "
            f"forces in N; else convert it, as docs/live_changes.md shows"
        )
    return state
