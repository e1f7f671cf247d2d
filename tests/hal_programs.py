"""Tests that need a LinuxCNC say so loudly where there is none."""

from __future__ import annotations

from functools import cache

import pytest

from feeddrive.export.linuxcnc_session import check_session
from feeddrive.language.errors import FeeddriveError


@cache
def missing() -> str:
    """Why LinuxCNC cannot be run here, and what to do; empty if it can."""
    try:
        check_session()
    except FeeddriveError as error:
        return f"NOT TESTED against LinuxCNC: {error!s}"
    return ""


needs_linuxcnc = pytest.mark.skipif(bool(missing()), reason=missing())
