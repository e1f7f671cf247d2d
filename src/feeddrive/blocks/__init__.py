"""The blocks: plants, friction, actuators, control laws, filters, encoders, references; one law per file.

The file name identifies a block, such as `controller/smith_law.py` for `SmithLaw`; there is no list of blocks.
"""

import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pkgutil import get_data
from typing import Any

from feeddrive.language.errors import nearest
from feeddrive.language.lazy_package import modules_below

_RENAMED = {"Shaped": "InputShaped"}  # until 1.0, as the kinds in catalogue.py


@cache
def by_file() -> Mapping[str, str]:
    """Map the class name of every block to its module; the source files are read, but no block is imported."""
    # imported late: the lazy `import feeddrive` must not load the language of blocks
    from feeddrive.language.block import snake_case

    places = {"Setpoint": f"{__name__}.signals"}  # users give it to references and prefilters
    for module in modules_below(__name__):
        package, _, stem = module.rpartition(".")
        text = (get_data(package, f"{stem}.py") or b"").decode()
        # classes beside a block, such as its states and prepared numbers, do not have the name of the file
        places |= {name: module for name in re.findall(r"(?m)^class (\w+)\(", text) if snake_case(name) == stem}
    return places


def __getattr__(name: str) -> Any:
    # importlib and pickle look for such names and expect AttributeError, not an import of all blocks
    if name.startswith("__"):
        raise AttributeError(name)
    if name in by_file():
        return getattr(import_module(by_file()[name]), name)
    if name in _RENAMED:
        raise AttributeError(f"fd.blocks.{name} is now fd.blocks.{_RENAMED[name]}")
    raise AttributeError(f"fd.blocks has no name '{name}'{nearest(name, by_file())}")


def __dir__() -> list[str]:
    return sorted(by_file())
