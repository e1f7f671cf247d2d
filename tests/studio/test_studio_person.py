"""From a log that nobody has seen to a control that compiles, as a person does it on the page; what is counted of it.

Actions are clicks, files that are chosen and fields that are written into. A person is taken to need 3 s for an action
and to read all text that the page shows, once, at 200 words a minute; what the page needs for its work is added.
"""

from __future__ import annotations

import logging
import shutil
import subprocess
import time
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd

_MOST_ACTIONS, _MOST_TIME = 25, 600.0  # s; the bars of the issue
_ACTION, _WORD = 3.0, 60.0 / 200.0  # s of a person
_MASS, _COULOMB, _KV, _KP, _T = 410.0, 230.0, 38.0, 9e4, 5e-4
# all text that is shown, without the entries of closed lists and without the recipes, which are there to be copied
_READ = """
() => {
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const parent = walk.currentNode.parentElement;
    if (parent.closest('option, pre, script, noscript, style') || !parent.checkVisibility()) continue;
    found.push(walk.currentNode.textContent.trim());
  }
  return found;
}
"""


class Person:
    """Somebody at the page, whose actions and words are counted."""

    def __init__(self, opened: Any) -> None:
        self.opened, self.page = opened, opened.page
        self.actions, self.waited = 0, 0.0
        self.read = set[str]()

    def click(self, what: str) -> None:
        """A click, and what it changes is read."""
        self._act(lambda: self.page.click(what))

    def choose(self, file: Path) -> None:
        """A file is chosen."""
        self._act(lambda: self.page.set_input_files("#files", str(file)))

    def write(self, what: str, text: str) -> None:
        """A field is written into, and left."""
        self._act(lambda: self.page.fill(what, text))
        self._act(lambda: self.page.keyboard.press("Tab"))

    def wait_for(self, what: str) -> None:
        """Something that a work makes is there; what came with it is read."""
        begun = time.monotonic()
        self.page.wait_for_selector(what, timeout=60e3)
        self.waited += time.monotonic() - begun
        self._look()

    def download(self, what: str, into: Path) -> Path:
        """A file that is taken away."""
        with self.page.expect_download() as waiting:
            self._act(lambda: self.page.click(what))
        path = into / waiting.value.suggested_filename
        waiting.value.save_as(path)
        return path

    @property
    def words(self) -> int:
        """That were read."""
        return sum(len(each.split()) for each in self.read)

    @property
    def seconds(self) -> float:
        """Of a person, by what was done and read; waiting depends on the machine and is only told."""
        return _ACTION * self.actions + _WORD * self.words

    def _act(self, act: Callable[[], None]) -> None:
        act()
        self.actions += 1
        self._look()

    def _look(self) -> None:
        self.opened.settled()
        self.read |= set(self.page.evaluate(_READ))


def unseen(path: Path, integral: float | None) -> None:
    """A log of an axis that the repository does not hold, with columns as a drive names them."""
    blocks = fd.blocks
    loop = fd.Loop(
        axis=fd.Axis(
            plant=blocks.Rigid(mass=_MASS),
            friction_load=blocks.Coulomb(coulomb=_COULOMB, viscous=900.0),
            actuator=blocks.Actuator(dead_time=_T),
            encoder_load=blocks.Encoder(resolution=1e-7, noise=5e-8),
        ),
        control=fd.Control(law=blocks.CascadePPI(Kv=_KV, Kp=_KP, Tn=integral), force_limit=12e3),
        sample_time=_T,
    )
    moves = [
        blocks.SnapLimitedMove(
            distance=distance,
            velocity=velocity,
            acceleration=acceleration,
            jerk=40.0,
            snap=2000.0,
            back=True,
            dwell_before=0.2,
            dwell_after=0.2,
        )
        for distance, velocity, acceleration in ((0.3, 0.6, 3.0), (0.12, 0.2, 2.0), (0.02, 0.05, 0.8))
    ]
    reference = np.concatenate([each.at(np.arange(round(each.duration / _T)) * _T).position for each in moves])
    run = fd.simulate(loop, blocks.Recorded(position=reference, sample_time=_T), seed=20261123)
    rows = slice(0, reference.size)
    columns = [1e3 * run.time[rows], 1e3 * reference, 1e3 * run["reading_load"][rows], run["force"][rows]]
    header = "Time (ms);PosCmd (mm);PosFbk (mm);Force (N)"
    np.savetxt(path, np.column_stack(columns), delimiter=";", header=header, comments="", fmt="%.6f")


@pytest.mark.slow(reason="a whole piece of work on the page: identification, a search, a proof, an export, a compiler")
@pytest.mark.parametrize("integral", [None, 0.022])
def test_from_an_unseen_log_to_a_control_that_compiles(
    served: Callable[..., Any], tmp_path: Path, integral: float | None
) -> None:
    """A law without an integral is found in the log; one with it is written into its field by its numbers."""
    log = tmp_path / "y_axis.csv"
    unseen(log, integral)
    person = Person(served().open())
    person.wait_for("#choose-files")
    person.choose(log)
    person.wait_for("#identify")
    if integral is not None:
        for name, value in (("Kv", _KV), ("Kp", _KP), ("Tn", 1e3 * integral)):
            person.write(f"#import-{name}", f"{value:g}")
    person.click("#identify")
    person.wait_for("#take-identified")
    person.click("#take-identified")
    person.wait_for("#verdict:not(:empty)")
    person.click("#tab-optimize")
    assert ("no integral action" in person.page.inner_text("#room-optimize")) == (integral is None)
    if integral is None:
        person.page.select_option("#optimize-field-law", "cascade_ppi")
    person.click("#tune-start")
    person.wait_for("#room-optimize .verdict")
    person.click("#optimize-accept")
    person.wait_for("#room-tune:not([hidden]) #verdict.good")
    person.click("#tab-prove")
    person.click("#prove-certify")
    person.wait_for("#proof-certificate h2:has-text('Proven.')")
    person.click("#tab-export")
    person.write("#guard-following_error_limit", "3")
    person.write("#guard-velocity_limit", "0.8")
    person.click("#guard-add")
    person.click("#export-target-c")
    person.wait_for("#export-archive-c")
    archive = person.download("#export-archive-c", tmp_path)
    machine = person.download("#export-machine", tmp_path)
    assert person.opened.said == []
    said = (
        f"{person.actions} actions, {person.words} words, {person.seconds:.0f} s, and {person.waited:.0f} s of waiting"
    )
    logging.getLogger("studio").info(said)  # pytest -o log_cli=true -o log_cli_level=INFO shows it
    assert person.actions <= _MOST_ACTIONS, said
    assert person.seconds <= _MOST_TIME, said
    found = tomllib.loads(machine.read_text(encoding="utf-8"))["axis"]["x"]
    assert found["plant"]["mass"] == pytest.approx(_MASS, rel=0.01)
    assert found["friction_load"]["coulomb"] == pytest.approx(_COULOMB, rel=0.02)
    assert found["control"]["guard"]["following_error_limit"] == pytest.approx(3e-3)
    assert (found["control"]["law"]["Kv"], found["control"]["law"]["Kp"]) != (_KV, _KP)  # it is not today's
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(tmp_path)
    (source,) = tmp_path.glob("*/axis_x_selftest.c")
    if shutil.which("make") is None or shutil.which("gcc") is None:
        pytest.skip("NOT TESTED: the export was not compiled: apt-get install gcc make")
    tested = subprocess.run(
        ["make", "-C", str(source.parent), "CC=gcc"], check=False, capture_output=True, text=True, timeout=120.0
    )
    assert tested.returncode == 0, tested.stderr
