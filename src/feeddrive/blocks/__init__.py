"""The blocks: plants, friction, actuators, control laws, filters, encoders, references; one law per file."""

from __future__ import annotations

import re
from importlib import import_module
from pkgutil import get_data
from typing import Any

from feeddrive.language.errors import nearest
from feeddrive.language.lazy_package import make_lazy, modules_below, public_names

_RENAMED = {"Shaped": "InputShaped"}  # until 1.0, as the kinds in catalogue.py


def _unlisted(name: str) -> Any:
    """A block that the stub does not list, found by the name of its module: `SmithLaw` in `smith_law.py`."""
    from feeddrive.language.block import snake_case

    file = f".{snake_case(name)}"
    for module in modules_below(__name__) if name[:1].isupper() else ():
        if module.endswith(file):
            return getattr(import_module(module), name)
    if name in _RENAMED:
        raise AttributeError(f"fd.blocks.{name} is now fd.blocks.{_RENAMED[name]}")
    raise AttributeError(f"fd.blocks has no name '{name}'{nearest(name, [*public_names(__name__), *_all_unlisted()])}")


def _all_unlisted() -> list[str]:
    """The blocks of the files that the stub does not name, found without importing them."""
    from feeddrive.language.block import snake_case

    listed, found = set(public_names(__name__).values()), list[str]()
    for module in modules_below(__name__):
        if module not in listed:
            package, _, stem = module.rpartition(".")
            text = (get_data(package, f"{stem}.py") or b"").decode()
            found += [name for name in re.findall(r"(?m)^class (\w+)\(", text) if snake_case(name) == stem]
    return found


make_lazy(__name__, _unlisted, _all_unlisted)
