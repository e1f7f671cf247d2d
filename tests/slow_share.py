"""Slow tests: each states its reason, and a share of them runs with every commit, drawn by the commit's hash."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

DURATIONS = Path(__file__).with_name("slow_durations.json")
UNKNOWN = 20.0  # s for a test that nobody timed


def missing_reasons(items: Iterable[pytest.Item]) -> list[str]:
    """Tests that are marked slow without a sentence that says why."""
    marks = ((item.nodeid, mark) for item in items for mark in item.iter_markers("slow"))
    return [name for name, mark in marks if not (mark.args == () and str(mark.kwargs.get("reason", "")).strip())]


def limits(items: Iterable[pytest.Item]) -> dict[str, float]:
    """What a test of its own `timeout` may take (s): who gives it half an hour did not mean `UNKNOWN` seconds."""
    marks = ((item.nodeid, item.get_closest_marker("timeout")) for item in items)
    return {name: float(mark.args[0]) for name, mark in marks if mark is not None and mark.args}


def drawn(names: Iterable[str], durations: Mapping[str, float], seconds: float, seed: str) -> set[str]:
    """Tests in an order given by the seed, as many as `seconds` of their stored durations hold.

    One that does not fit is passed over; one that is longer than `seconds` alone is never drawn.
    """
    left, share = seconds, set[str]()
    for name in sorted(names, key=lambda name: hashlib.sha256(f"{seed} {name}".encode()).digest()):
        needed = durations.get(name, UNKNOWN)
        if needed <= left:
            left -= needed
            share.add(name)
    return share


def all_but(quick: Container[Any], cases: Iterable[Any], reason: str) -> list[Any]:
    """Parameters of a test of which all but the `quick` ones are slow, for the same reason."""
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=() if case in quick else pytest.mark.slow(reason=reason),
        )
        for case in cases
    ]


def read_durations() -> dict[str, float]:
    """The stored durations (s) by the name of the test."""
    return json.loads(DURATIONS.read_text(encoding="utf-8")) if DURATIONS.exists() else {}


def write_durations(found: Mapping[str, float]) -> None:
    """Store what a run of slow tests took, beside what is stored of the others."""
    merged = {**read_durations(), **{name: round(seconds, 1) for name, seconds in found.items()}}
    DURATIONS.write_text(json.dumps(dict(sorted(merged.items())), indent=0) + "\n", encoding="utf-8")


def commit() -> str:
    """The hash of the commit that is checked out; of nothing outside a repository."""
    asked = ["git", "-C", str(DURATIONS.parent), "rev-parse", "HEAD"]
    done = subprocess.run(asked, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False)
    return done.stdout.strip() or "no commit"
