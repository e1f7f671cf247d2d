"""An axis of LinuxCNC from unknown to a loop that runs: the whole chain with a real halrun."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from feeddrive.bus.drive_file import BusLimits
from feeddrive.export.drive_quantities import read_cascade
from feeddrive.export.linuxcnc_axis import simulated_linuxcnc_axis
from feeddrive.export.linuxcnc_pid import stock_law
from feeddrive.files.machine import read_machine
from feeddrive.language.progress import Progress
from feeddrive.loop.loop import Loop
from feeddrive.workflow.commission import commission
from feeddrive.workflow.commission_steps import CommissionRequest
from hal_programs import needs_linuxcnc


class Person(Progress):
    """Says yes, and finds with a ruler what the axis counts."""

    def confirm(self, question: str) -> bool:
        return True

    def measured(self, question: str, expected: float, unit: str) -> float:
        return expected


def slower(loop: Loop, share: float) -> Loop:
    """The loop with a share of the gains of its cascade: a control that was set up with care and no more."""
    law = read_cascade(loop).law
    assert law.Tn is not None
    law = replace(law, Kv=share * law.Kv, Kp=share * law.Kp, Tn=law.Tn / share)
    return replace(loop, control=replace(loop.control, law=law))


@needs_linuxcnc
@pytest.mark.slow(reason="a commissioning from end to end, with a tuning and a session of HAL")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("trial", "target"), [("component", "linuxcnc"), ("gains", "linuxcnc-pid")])
def test_an_axis_of_linuxcnc_is_commissioned_by_its_file(tmp_path: Path, trial: str, target: str) -> None:
    """The shop's pids are at half of what the axis bears; its file does not say what a count of the encoder is.

    By the exported component beside them, and by their gains alone.
    """
    limits = BusLimits(travel=0.1, velocity=0.5, force=2000.0, following_error=5e-3, quick_stop_deceleration=5.0)
    old = stock_law(read_cascade(slower(read_machine("linear_motor").loop("x"), 0.5)))
    simulated_linuxcnc_axis("linear_motor", limits, tmp_path, old=old)
    file = tmp_path / "axis.toml"
    lines = file.read_text().splitlines(keepends=True)
    content = "".join(line for line in lines if not line.startswith("increment"))
    file.write_text(content.replace("trial = 'component'", f"trial = '{trial}'"))
    done = commission.run(CommissionRequest(file, out=tmp_path / "done", target=target), Person()).result
    assert done.kept, done.refusal
    assert done.trial is not None
    assert done.trial.before is not None
    assert done.trial.agrees
    assert done.trial.measured.following_rms < 0.5 * done.trial.before.following_rms
    assert done.questions <= 8
    exported = next((tmp_path / "done").glob("*_export"))
    assert (exported / ("axis_x.comp" if trial == "component" else "axis-x.ini")).is_file()
