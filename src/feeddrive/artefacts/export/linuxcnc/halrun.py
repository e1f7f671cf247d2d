"""Components run in LinuxCNC's own HAL, alone on the machine: streamed in, stepped, and read back to the last bit.

A run has its own IPC namespace, since HAL's shared memory is one for the whole machine, and its own mount namespace,
since `halcompile --install` writes where all components are: a LinuxCNC that runs beside it sees nothing of it.  Nor is
time waited for: the thread's period stays what it is, but the next one begins when the last one is done.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.language.errors import FeeddriveError, ParameterError

MODULES = "/usr/lib/linuxcnc/modules"
STREAMER_PINS = 20  # of one streamer and of one sampler
_PACKAGES = {
    "halrun": "linuxcnc-uspace",
    "halcompile": "linuxcnc-uspace-dev",
    "gcc": "gcc",
    "make": "make",
    "unshare": "util-linux",
    "/usr/bin/python3": "python3",
}


class HalError(FeeddriveError):
    """A program of LinuxCNC is missing, or its HAL did not take a component; the message says what to install or do."""


@dataclass(frozen=True, eq=False)
class HalRun:
    """What a run gave back: a row of numbers for each sample, and what the programs printed."""

    rows: np.ndarray
    printed: str


def check_programs() -> None:
    """Raise HalError, naming program and package, unless LinuxCNC and what compiles for it are installed."""
    missing = [program for program in _PACKAGES if shutil.which(program) is None]
    if missing:
        packages = " ".join(dict.fromkeys(_PACKAGES[program] for program in missing))
        raise HalError(f"LinuxCNC: {', '.join(missing)} not found: run  apt-get install {packages}")


def halrun(
    components: Sequence[Path],
    folder: Path,
    period: int,
    wiring: str,
    given: np.ndarray,
    types: str,
    taken: str,
    *,
    meanwhile: str = "",
    at_end: str = "",
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

    Raises HalError if a program is missing, fails, or does not end in time.
    """
    check_programs()
    if not 0 < len(types) < STREAMER_PINS or not 0 < len(taken) <= STREAMER_PINS:
        raise ParameterError(f"a run has 1 to {STREAMER_PINS - 1} numbers in and 1 to {STREAMER_PINS} out")
    count = len(given)
    for each in components:
        for file in each.parent.iterdir():
            if file.suffix in (".comp", ".h", ".c") and not (folder / file.name).exists():
                shutil.copy(file, folder / file.name)
    (folder / "in.txt").write_text(_rows(given, types))
    (folder / "drain.py").write_text(_DRAIN)
    (folder / "unpaced.c").write_text(_UNPACED)
    (folder / "run.hal").write_text(
        _HAL.format(
            period=period,
            depth=count + 2,
            types=types,
            taken=taken,
            wiring=wiring,
            valid=len(types),
            count=count,
            meanwhile=meanwhile,
            at_end=at_end,
            patience=patience,
        )
    )
    (folder / "session.sh").write_text(
        _SESSION.format(
            modules=MODULES,
            components=" ".join(each.name for each in components),
            preload="" if paced else "LD_PRELOAD=$PWD/unpaced.so ",
            run="halrun -f run.hal",
        )
    )
    printed = session(folder, patience)
    out = folder / "out.bin"
    rows = np.fromfile(out, dtype="<f8").reshape(-1, len(taken)) if out.exists() else np.empty((0, len(taken)))
    if len(rows) != count:
        raise HalError(f"LinuxCNC's HAL gave {len(rows)} of {count} samples back; it said:\n{printed[-2000:]}")
    return HalRun(rows, printed)


def session(folder: Path, patience: float) -> str:
    """Run `session.sh` of a folder in namespaces of its own and give back what it printed. Raises HalError."""
    root = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    command = [
        "unshare",
        *root,
        "--ipc",
        "--mount",
        "--pid",
        "--fork",
        "--kill-child",
        "--mount-proc",
        "bash",
        "session.sh",
    ]
    program = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        text=True, errors="replace", start_new_session=True,
    )  # fmt: skip
    try:
        printed, _ = program.communicate(timeout=patience + 10.0)
    except BaseException as error:
        os.killpg(program.pid, signal.SIGKILL)
        printed, _ = program.communicate()
        if isinstance(error, subprocess.TimeoutExpired):
            raise HalError(f"LinuxCNC's HAL did not end within {patience:g} s; it said:\n{printed[-2000:]}") from None
        raise
    if program.returncode != 0:
        raise HalError(f"LinuxCNC's HAL failed:\n{printed[-3000:]}")
    return printed


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


# A private tmpfs over the folder of the components holds copies of them, what is installed, and the socket.
_SESSION = """\
set -e
mkdir -p mine
cp {modules}/*.so mine
mount -t tmpfs -o mode=1777 feeddrive {modules}
cp mine/*.so {modules}
for each in {components}; do halcompile --install $each; done
gcc -shared -fPIC -O1 -o unpaced.so unpaced.c
export RTAPI_UID=65534 RTAPI_FIFO_PATH={modules}/socket HOME=$PWD
{preload}{run}
"""

_UNPACED = """\
#define _GNU_SOURCE
#include <time.h>

/* A thread of HAL waits for its next period by this call: it does not wait at all. */
int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
{
    (void)clock, (void)flags, (void)until, (void)left;
    return 0;
}
"""

_HAL = """\
loadrt threads name1=servo-thread period1={period}
loadrt streamer depth={depth} cfg={types}b
loadrt sampler depth={depth} cfg={taken}
addf streamer.0 servo-thread
{wiring}
addf sampler.0 servo-thread
net valid streamer.0.pin.{valid} => sampler.0.enable
loadusr -w halstreamer in.txt
start
{meanwhile}
loadusr -w /usr/bin/python3 drain.py {count} {patience}
{at_end}
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
