"""The independent check of `benchmarks/travel.py` as a module: it shares no model of plant or law with the package."""

from __future__ import annotations

import sys
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType


@cache
def load() -> ModuleType:
    """Return the module of `benchmarks/travel.py`."""
    spec = spec_from_file_location("draws_along_travel", Path(__file__).parents[1] / "benchmarks" / "travel.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["draws_along_travel"] = module
    spec.loader.exec_module(module)
    return module
