"""A machine file with tuned numbers in it: what stands there is in the unit of its key."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.machine import BUNDLED
from feeddrive.language import tree
from feeddrive.plot.drawing import drawn
from feeddrive.tuning.candidates import candidates
from feeddrive.workflow.control_text import machine_text
from feeddrive.workflow.tune_files import Story, old_and_new


def test_the_old_value_in_a_comment_has_the_unit_of_its_key(tmp_path: Path) -> None:
    text = (BUNDLED / "machines" / "linear_motor.toml").read_text()
    loop = fd.read_machine("linear_motor").loop("x")
    Kp, Tn = (float(fd.parameters(loop)[f"axis.x.control.law.{name}"]) for name in ("Kp", "Tn"))
    for name, written in (("Kp", f"Kp_kN_s_per_m = {Kp / 1e3!r}"), ("Tn", f"Tn_ms = {1e3 * Tn!r}")):
        text, count = re.subn(rf"(?m)^{name}\w* *=[^\n]*", written, text)
        assert count == 1
    (tmp_path / "axis.toml").write_text(text)
    machine = fd.read_machine(tmp_path / "axis.toml")
    new = fd.vary(
        machine.loop("x"),
        {"axis.x.control.law.Kp": 2.0 * Kp, "axis.x.control.law.Tn": 3.0 * Tn, "axis.x.control.law.Kv": 7.0},
    )
    made = machine_text(machine, "x", new.control)
    assert re.search(rf"(?m)^Kp_kN_s_per_m = {2.0 * Kp / 1e3:.7g}\b.*# was {Kp / 1e3:.7g}$", made), made
    assert re.search(rf"(?m)^Tn_ms = {3e3 * Tn:.7g}\b.*# was {1e3 * Tn:.7g}$", made), made
    assert re.search(rf"(?m)^Kv = 7\b.*was {float(fd.parameters(loop)['axis.x.control.law.Kv']):.7g}$", made), made


def test_old_and_new_in_time_are_runs_of_both_loops() -> None:
    """With twice the Kv the step is reached in about half the time; both end at the step, and at 0 after the rope.

    0.1 um: friction of 30 N holds the table a few counts of 10 nm off; the move ends with no more.
    """
    loop = fd.read_machine("linear_motor").loop("x")
    faster = fd.vary(loop, {"axis.x.control.law.Kv": 2.0 * float(fd.parameters(loop)["axis.x.control.law.Kv"])})
    shown = old_and_new(Story("axis", {}, loops={"today": loop, "new": faster}), 160.0)
    step, rope, move = drawn(shown.chart()).axes
    for ax, end in ((step, 20.0), (rope, 0.0), (move, 0.0)):
        assert [line.get_label() for line in ax.get_lines()] == ["today", "new"]
        for line in ax.get_lines():
            assert line.get_ydata()[-1] == pytest.approx(end, abs=0.1)
    rises = [line.get_xdata()[np.argmax(line.get_ydata() > 0.63 * 20.0)] for line in step.get_lines()]
    assert 0.35 < rises[1] / rises[0] < 0.7
    assert max(rope.get_lines()[0].get_ydata()) > 0.5, "the table springs towards where the rope did not pull"


@pytest.mark.parametrize("name", ["linear_motor", "ball_screw", "xy_table"])
def test_the_file_has_the_control_of_every_law_that_can_be_tuned(name: str, tmp_path: Path) -> None:
    """Read back: the same blocks with the same parameters to seven digits, also for a law without its integral.

    Before, a parameter that the new form lacks stayed in the file: P-P + DOB kept the Tn of the P-PI.
    """
    machine = fd.read_machine(name)
    laws, _ = candidates(machine.loop("x"))
    assert len(laws) > 10
    for law in laws:
        wanted = law.loop.control
        (tmp_path / "axis.toml").write_text(machine_text(machine, "x", wanted), encoding="utf-8")
        read = fd.read_machine(tmp_path / "axis.toml").loop("x").control
        for part in ("law", "filters", "feedforward", "compensation", "prefilter"):
            there, asked = getattr(read, part), getattr(wanted, part)
            assert tree.structure(there) == tree.structure(asked), f"{law.name}: {part}"
            assert dict(tree.leaves(there)) == pytest.approx(dict(tree.leaves(asked)), rel=1e-6), f"{law.name}: {part}"
