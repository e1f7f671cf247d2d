"""Exported C of other compilers and on other processors (qemu-user), bit for bit; see tests/foreign_machines.py.

What is not installed is skipped, loudly.
"""

from __future__ import annotations

import shutil

import pytest

import foreign_machines
from exported import LOOPS
from feeddrive.export.c_bundle import streamed
from feeddrive.export.c_code import texts
from feeddrive.export.design import trial
from feeddrive.export.layout import layout
from feeddrive.language.errors import FileError
from foreign_machines import MACHINES, X87, different, loops
from slow_share import all_but

SHARES = 8  # every eighth loop in a test, so that a share of the slow tests holds some of each machine
PARTS = [(machine, part) for machine in MACHINES for part in range(SHARES)]


def needs(machine: str) -> None:
    """Skip the test if the machine's compiler or emulator is not installed."""
    if why := MACHINES[machine].missing():
        pytest.skip(f"{why}: exported C on {machine}")


def test_every_loop_that_a_machine_file_can_hold_is_run_on_foreign_machines() -> None:
    """All loops of the tests but the one whose feedforward is a block of the tests, and every bundled machine."""
    assert set(LOOPS) - set(loops()) == {"cascade_ppi, rings and reversals"}
    assert sum("axis" in name for name in loops()) >= 15


@pytest.mark.parametrize("machine", all_but(["s390x"], MACHINES, "the same on others"))
def test_a_loop_has_the_simulators_bits_on_another_machine(machine: str) -> None:
    needs(machine)
    assert different("cascade_ppi, learned force", MACHINES[machine], 2_000, 3) == 0


@pytest.mark.slow(reason="seven or six loops a test on each of seven machines: compilers, and emulated processors")
@pytest.mark.parametrize(("machine", "part"), PARTS)
def test_all_loops_have_the_simulators_bits_on_another_machine(machine: str, part: int) -> None:
    """20,000 samples of each loop with limits, trips, broken numbers and 20 live changes."""
    needs(machine)
    found = {name: different(name, MACHINES[machine], 20_000, 1) for name in list(loops())[part::SHARES]}
    assert found == dict.fromkeys(found, 0)


@pytest.mark.skipif(shutil.which(X87[0]) is None, reason="NOT RUN: an x87: apt-get install gcc-i686-linux-gnu")
def test_an_x87_is_refused() -> None:
    """It computes in 80 bits: the header does not compile."""
    planned = layout(foreign_machines.routine_of("dadsc"))
    made = texts(planned, "a control under test", "made by a test")
    files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
    with pytest.raises(FileError, match="FLT_EVAL_METHOD is not 0, as on an x87"):
        streamed(planned, files, trial(planned.routine, 10), flags=X87[1], command=X87[0])


def test_a_processor_that_widens_short_reals_is_refused_single_precision_alone() -> None:
    """In strict C99 gcc computes float as double on an s390x: other bits, which -fexcess-precision=fast mends."""
    needs("s390x")
    planned = layout(foreign_machines.routine_of("cascade_ppi, plain"), "float")
    made = texts(planned, "a control under test", "made by a test")
    files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
    machine = MACHINES["s390x"]
    with pytest.raises(FileError, match="FLT_EVAL_METHOD is not 0"):
        streamed(planned, files, trial(planned.routine, 10), flags=machine.flags, command=machine.command)
