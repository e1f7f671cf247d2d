"""Components run in LinuxCNC's own HAL: streamed in, stepped, and read back to the last bit.

Time is not waited for: the thread's period stays what it is, but the next one begins when the last one is done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.export.linuxcnc.session import HalError, session
from feeddrive.language.errors import ParameterError

STREAMER_PINS = 20  # of one streamer and of one sampler


@dataclass(frozen=True, eq=False)
class HalRun:
    """What a run gave back: a row of numbers for each sample, and what the programs printed."""

    rows: np.ndarray
    printed: str


def halrun(
    components: Sequence[Path],
    folder: Path,
    period: int,
    wiring: Sequence[str],
    given: np.ndarray,
    types: str,
    taken: str,
    *,
    meanwhile: Sequence[str] = (),
    at_end: Sequence[str] = (),
    paced: bool = False,
    patience: float = 60.0,
) -> HalRun:
    """Install components, stream rows in and take rows out, one a period of a servo thread.

    components  .comp files, each with the files that it includes beside it
    folder      an empty place for what is made on the way
    period      of the thread `servo-thread`, ns
    wiring      commands of halcmd: they load and add components between streamer and sampler, and connect
                `streamer.0.pin.N` and `sampler.0.pin.N`
    given       the rows, shape (n, len(types)); types and taken: one letter a pin, f float, b bit, s signed, u unsigned
    meanwhile   commands of halcmd once the thread runs;  at_end: once all rows are there
    paced       wait for every period, as on a machine
    patience    s until the run is given up

    Raises MissingProgramError without LinuxCNC, and HalError if it fails or does not end in time.
    """
    if not 0 < len(types) < STREAMER_PINS or not 0 < len(taken) <= STREAMER_PINS:
        raise ParameterError(f"a run has 1 to {STREAMER_PINS - 1} numbers in and 1 to {STREAMER_PINS} out")
    (folder / "in.txt").write_text(_rows(given, types))
    (folder / "drain.py").write_text(_DRAIN)
    (folder / "unpaced.c").write_text(_UNPACED)
    lines = [
        f"loadrt threads name1=servo-thread period1={period}",
        f"loadrt streamer depth={len(given) + 2} cfg={types}b",
        f"loadrt sampler depth={len(given) + 2} cfg={taken}",
        "addf streamer.0 servo-thread", *wiring, "addf sampler.0 servo-thread",
        f"net valid streamer.0.pin.{len(types)} => sampler.0.enable",
        "loadusr -w halstreamer in.txt",
        "start", *meanwhile,
        f"loadusr -w /usr/bin/python3 drain.py {len(given)} {patience}", *at_end,
    ]  # fmt: skip
    (folder / "run.hal").write_text("\n".join(lines) + "\n")
    unpaced = "gcc -shared -fPIC -O1 -o unpaced.so unpaced.c; LD_PRELOAD=$PWD/unpaced.so "
    printed = session(folder, components, f"{'' if paced else unpaced}halrun -f run.hal", patience)
    out = folder / "out.bin"
    rows = np.fromfile(out, dtype="<f8").reshape(-1, len(taken)) if out.exists() else np.empty((0, len(taken)))
    if len(rows) != len(given):
        raise HalError(f"LinuxCNC's HAL gave {len(rows)} of {len(given)} samples back; it said:\n{printed[-2000:]}")
    return HalRun(rows, printed)


def _rows(given: np.ndarray, types: str) -> str:
    """Rows for halstreamer, to the last digit, each with a 1; behind them a row that does not count."""
    words = [repr if letter == "f" else _whole for letter in types]
    lines = [
        " ".join([*(word(value) for word, value in zip(words, row, strict=True)), "1"])
        for row in np.asarray(given, dtype=float).tolist()
    ]
    return "\n".join([*lines, " ".join(["0"] * (len(types) + 1))]) + "\n"


def _whole(value: float) -> str:
    return str(int(value))


# a thread of HAL waits for its next period by this call
_UNPACED = """\
#define _GNU_SOURCE
#include <time.h>

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
{
    (void)clock, (void)flags, (void)until, (void)left;
    return 0;
}
"""

# halsampler prints six decimals; HAL's Python module reads all of them
_DRAIN = """\
import struct, sys, time
import hal

count, patience = int(sys.argv[1]), float(sys.argv[2])
component = hal.component("drain")
stream = hal.stream(component, 0x48534130)
row = struct.Struct("<%dd" % len(stream.element_types))
component.ready()
done, until = 0, time.monotonic() + patience
with open("out.bin", "wb") as out:
    while done < count and time.monotonic() < until:
        while done < count and stream.readable:
            out.write(row.pack(*map(float, stream.read())))
            done += 1
        time.sleep(0.001)
component.exit()
"""
