"""The report of a study: one self-contained HTML page. `build(study)` returns its text."""

from __future__ import annotations

from feeddrive.report.page import Entry, Study
from feeddrive.report.study_page import build

__all__ = ["Entry", "Study", "build"]
