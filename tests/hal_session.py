"""A real LinuxCNC HAL for tests: components of Debian's linuxcnc-uspace, fed by a streamer, read at full precision.

Each session has namespaces and a socket of its own, so that sessions run side by side and a killed one leaves nothing
behind.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

PYTHON = "/usr/bin/python3"  # Debian's, for which the module `hal` is built
NOBODY = "65534"  # whom HAL's real-time part becomes when it is started by root
SECONDS = 30

# the module's own text output has six decimals; a stream has all bits
DRAIN = """
import struct, sys, time
import hal
rows, path, first = int(sys.argv[1]), sys.argv[2], []
component = hal.component("drain")
stream = hal.stream(component, 0x48534130)
component.ready()
end = time.monotonic() + {seconds}
with open(path, "wb") as out:
    while rows and time.monotonic() < end:
        row = stream.read()
        if row is None:
            time.sleep(0.001)
            continue
        out.write(struct.pack("<%dd" % len(row), *row))
        rows -= 1
"""


def why_not() -> str:
    """Why no HAL can be started here, with what to install; empty if it can."""
    if shutil.which("halrun") is None:
        return "NOT TESTED against LinuxCNC: no halrun; apt-get install linuxcnc-uspace"
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        return "NOT TESTED against LinuxCNC: a HAL of one's own needs root and unshare (apt-get install util-linux)"
    return ""


needs_hal = pytest.mark.skipif(bool(why_not()), reason=why_not())


def run_hal(
    folder: Path,
    rows: np.ndarray,
    *,
    load: Sequence[str],
    functions: Sequence[str],
    wires: Sequence[tuple[str, str, str]],
    outputs: Sequence[str],
    settings: Mapping[str, float | int] | None = None,
    period: int = 50_000,
    always: Sequence[str] = (),
) -> np.ndarray:
    """One row of outputs for each row of inputs, shape (n, len(outputs)).

    load       lines that load components
    functions  in the order of the thread; the streamer comes first and the sampler last
    wires      (kind, name, pins) for each column of `rows`: "float" or "bit", a signal, the pins that read it
    outputs    pins that are recorded
    settings   pins and parameters that are set before the thread starts; a whole number for a bit
    period     of the thread, ns
    always     further lines, such as nets between components
    """
    folder.chmod(0o777)
    for parent in folder.parents[:3]:
        parent.chmod(parent.stat().st_mode | 0o055)
    kinds = "".join("f" if kind == "float" else "b" for kind, _, _ in wires)
    depth = len(rows) + 10
    lines = [
        f"loadrt streamer depth={depth} cfg=b{kinds}",
        f"loadrt sampler depth={depth} cfg={'f' * len(outputs)}",
        *load,
        f"loadrt threads name1=servo period1={period}",
        "addf streamer.0 servo",
        *(f"addf {function} servo" for function in functions),
        "addf sampler.0 servo",
        "net valid streamer.0.pin.0 => sampler.0.enable",
        *(f"net {name} streamer.0.pin.{i + 1} => {pins}" for i, (_, name, pins) in enumerate(wires)),
        *always,
        *(f"net out{i} {pin} => sampler.0.pin.{i}" for i, pin in enumerate(outputs)),
        *(f"setp {name} {value!r}" for name, value in (settings or {}).items()),
        "loadusr -w halstreamer input.txt",
        "start",
        f"loadusr -w {PYTHON} drain.py {len(rows)} output.bin",
    ]
    (folder / "session.hal").write_text("\n".join(lines) + "\n")
    (folder / "drain.py").write_text(DRAIN.format(seconds=SECONDS))
    whole = [[repr(float(v)) if k == "f" else str(int(v)) for k, v in zip(kinds, row, strict=True)] for row in rows]
    idle = " ".join("0" for _ in kinds)
    (folder / "input.txt").write_text("".join(f"1 {' '.join(row)}\n" for row in whole) + f"0 {idle}\n")
    environment = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": str(folder),
        "RTAPI_UID": NOBODY,
        "RTAPI_FIFO_PATH": str(folder / "fifo"),
    }
    # halrun refuses to start beside another real-time part that it sees, so it sees no process but its own
    alone = ["unshare", "--ipc", "--pid", "--fork", "--kill-child", "--mount-proc"]
    command = ["timeout", "-k", "2", str(SECONDS + 10), *alone, "halrun", "-f", "session.hal"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    found = np.fromfile(folder / "output.bin") if (folder / "output.bin").exists() else np.empty(0)
    assert found.size == len(rows) * len(outputs), done.stdout + done.stderr
    return found.reshape(len(rows), len(outputs))
