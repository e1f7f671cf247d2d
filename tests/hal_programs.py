"""Tests that need a LinuxCNC say so loudly where there is none."""

from __future__ import annotations

import pytest

from feeddrive.artefacts.export.linuxcnc.session import check_programs
from feeddrive.language.errors import MissingProgramError


def missing() -> str:
    """Which programs are not there, and what to install; empty if all are."""
    try:
        check_programs()
    except MissingProgramError as error:
        return f"NOT TESTED against LinuxCNC: {error}"
    return ""


needs_linuxcnc = pytest.mark.skipif(bool(missing()), reason=missing())
