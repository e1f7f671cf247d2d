"""Provenance of a run: the versions needed to repeat it, and the names of the files that hold it."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from feeddrive.version import __version__


def versions() -> dict[str, str]:
    """What is needed to repeat a run: of feeddrive, Python and the libraries that compute."""
    import llvmlite
    import scipy

    return {
        "feeddrive": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "llvmlite": llvmlite.__version__,
    }


def file_names(rows: Iterable[Any]) -> list[str]:
    """A file name for each law: its letters and digits, and a number where two would be the same."""
    names: list[str] = []
    for row in rows:
        plain = re.sub(r"[^a-z0-9]+", "_", row.name.lower()).strip("_") or "law"
        names.append(plain if plain not in names else f"{plain}_{len(names) + 1}")
    return names
