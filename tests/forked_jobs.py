"""What jobs of a page are forked from in tests: all that they would import, and reports without their pictures.

A job of the studio is a process of its own that begins anew and imports for a second. Tests of what a job does need
its process, but not its beginning, which those of the server and of the page have.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.context import BaseContext
from types import ModuleType

import pytest


def forking() -> BaseContext | None:
    """The context whose processes are forked from one that has imported this module; None where there is no fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return None
    from multiprocessing.forkserver import ensure_running

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
        ensure_running()
    return context


@contextmanager
def forked(module: ModuleType) -> Generator[None]:
    """Meanwhile the processes of a module are forked, where there is a fork."""
    with pytest.MonkeyPatch.context() as patch:
        if (context := forking()) is not None:
            patch.setattr(module, "_CONTEXT", context)
        yield


# in the process from which the others are forked; importing this module elsewhere loads nothing more
if "from multiprocessing.forkserver import main" in " ".join(sys.orig_argv):
    import feeddrive.evaluation.engine
    import feeddrive.loop.engine.llvm
    import feeddrive.report.page
    import feeddrive.studio.uploads
    import feeddrive.studio.works
    import no_pictures
    from feeddrive.workflow.command import COMMANDS, load

    for _command in COMMANDS:
        load(_command)
    # what they import late
    for _name in ("jinja2", "matplotlib.backends.backend_svg", "scipy.optimize", "scipy.signal"):
        import_module(_name)
    feeddrive.report.page.svg = no_pictures.empty
    feeddrive.evaluation.engine._CONTEXT = multiprocessing.get_context("forkserver")  # type: ignore[assignment]
