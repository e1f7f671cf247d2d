"""feeddrive: the servo loop of a machine-tool feed drive, from a measured log or a machine file to a proven loop.

Every block is a name of this package (`feeddrive.TwoMass`, `feeddrive.CascadePPI`), found by the file it stands in, and
so are the few functions that work on a loop.  Names are loaded on first use, so that `import feeddrive` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# What is not a block: name -> module that holds it.
_PLACES: dict[str, str] = {
    "Axis": "loop.axis",
    "Control": "loop.control",
    "FRF": "loop.frequency_response",
    "FeeddriveError": "language.errors",
    "Gradient": "loop.gradient",
    "Guard": "loop.guard",
    "Loop": "loop.loop",
    "Run": "loop.simulate",
    "Setpoint": "blocks.signals",
    "Signals": "loop.loop",
    "StateSpace": "loop.linearize",
    "compliance": "loop.linearize",
    "gradient": "loop.gradient",
    "linearize": "loop.linearize",
    "loop_gain": "loop.linearize",
    "simulate": "loop.simulate",
    "simulate_batch": "loop.simulate",
    "stream": "loop.simulate",
    "tracking": "loop.linearize",
    "vary": "language.tree",
}

if TYPE_CHECKING:
    from feeddrive.blocks.signals import Setpoint as Setpoint
    from feeddrive.language.errors import FeeddriveError as FeeddriveError
    from feeddrive.language.tree import vary as vary
    from feeddrive.loop.axis import Axis as Axis
    from feeddrive.loop.control import Control as Control
    from feeddrive.loop.frequency_response import FRF as FRF
    from feeddrive.loop.gradient import Gradient as Gradient
    from feeddrive.loop.gradient import gradient as gradient
    from feeddrive.loop.guard import Guard as Guard
    from feeddrive.loop.linearize import StateSpace as StateSpace
    from feeddrive.loop.linearize import compliance as compliance
    from feeddrive.loop.linearize import linearize as linearize
    from feeddrive.loop.linearize import loop_gain as loop_gain
    from feeddrive.loop.linearize import tracking as tracking
    from feeddrive.loop.loop import Loop as Loop
    from feeddrive.loop.loop import Signals as Signals
    from feeddrive.loop.simulate import Run as Run
    from feeddrive.loop.simulate import simulate as simulate
    from feeddrive.loop.simulate import simulate_batch as simulate_batch
    from feeddrive.loop.simulate import stream as stream


def __getattr__(name: str) -> Any:
    """A public name, loaded on first use: one of `_PLACES`, or a block by the module that is named as it is."""
    from importlib import import_module

    if name in _PLACES:
        found = getattr(import_module(f"feeddrive.{_PLACES[name]}"), name)
    else:
        found = _block(name)
        if found is None:
            raise AttributeError(f"module 'feeddrive' has no name '{name}'")
    globals()[name] = found
    return found


def _block(name: str) -> Any:
    """The block with a class name, or None."""
    if not name[:1].isupper():
        return None
    from importlib import import_module

    from feeddrive.blocks.catalogue import modules
    from feeddrive.language.block import snake_case

    file = f".{snake_case(name)}"
    return next((getattr(import_module(module), name, None) for module in modules() if module.endswith(file)), None)


def __dir__() -> list[str]:
    """All public names, blocks included; imports every block."""
    from feeddrive.blocks.catalogue import catalogue

    blocks = {block.__name__ for members in catalogue().values() for block in members.values()}
    return sorted({*_PLACES, *blocks, "__version__"})
