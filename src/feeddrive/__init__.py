"""feeddrive: the servo loop of a machine-tool feed drive, from a measured log or a machine file to a proven loop.

Every block is a name of this package (`feeddrive.TwoMass`, `feeddrive.CascadePPI`), found by the file it stands in, and
so are the few functions that work on a loop, which `__init__.pyi` lists.  Names are loaded on first use, so that
`import feeddrive` stays quick.
"""

from __future__ import annotations

import pkgutil
import re
from typing import Any

from feeddrive.language.table import views_from

_LISTED = (pkgutil.get_data(__name__, "__init__.pyi") or b"").decode()
# public name -> module that holds it
_PLACES: dict[str, str] = {
    name: module for module, name in re.findall(r"(?m)^from (feeddrive[.\w]+) import \(?\s*(\w+)", _LISTED)
}


def _load_views() -> object:
    """Import what draws and frames results; the first `plot()` or `to_pandas()` of a result asks for it."""
    from feeddrive import plot

    return plot


views_from(_load_views)


def __getattr__(name: str) -> Any:
    """A public name, loaded on first use: one of those listed, or a block by the module that is named as it is."""
    from importlib import import_module

    if name in _PLACES:
        found = getattr(import_module(_PLACES[name]), name)
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
    return sorted({*_PLACES, *blocks})
