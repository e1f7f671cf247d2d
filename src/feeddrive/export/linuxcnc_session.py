"""LinuxCNC programs in isolated sessions, which leave the system unchanged, and controllers run in a real HAL.

HAL's shared memory exists once per computer, `halcompile --install` writes to the common component directory, and a
killed real-time process leaves remnants.  A session therefore has separate IPC, mount, process and network namespaces.
A running LinuxCNC and its installation are not affected.  Unprivileged use requires a kernel with user namespaces.
"""

import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.export.design import Answers, Design, Trial
from feeddrive.export.linuxcnc import hal, input_pin, servo_period, text
from feeddrive.language.errors import FeeddriveError, MissingProgramError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.loop import quantity
from feeddrive.loop.routine import Routine

MODULES = "/usr/lib/linuxcnc/modules"
PACKAGES = {
    "halrun": "linuxcnc-uspace",
    "halcompile": "linuxcnc-uspace-dev",
    "gcc": "gcc",
    "make": "make",
    "unshare": "util-linux",
    "/usr/bin/python3": "python3",
}


class HalError(FeeddriveError):
    """The error if LinuxCNC rejects a component, fails or does not end; the message contains the output."""

    exit_code = 1


class HalTimeoutError(HalError):
    """The error if LinuxCNC does not end; `printed` is all that it said until then."""

    def __init__(self, message: str, printed: str) -> None:
        super().__init__(message)
        self.printed = printed


def check_programs() -> None:
    """Raise MissingProgramError, naming the packages, unless LinuxCNC and its compiler are installed."""
    missing = [program for program in PACKAGES if shutil.which(program) is None]
    if missing:
        packages = dict.fromkeys(PACKAGES[program] for program in missing)
        raise MissingProgramError("', '".join(missing), " ".join(packages), "running a component in LinuxCNC")


def check_session() -> None:
    """Raise MissingProgramError as `check_programs` does, and HalError if the system permits no isolated session."""
    check_programs()
    tried = subprocess.run(
        [*_alone(), "mount", "-t", "tmpfs", "feeddrive", MODULES],
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if tried.returncode != 0:
        reason = (tried.stderr.splitlines() or ["no message."])[0]
        raise HalError(
            f"LinuxCNC cannot be run apart from the rest of this machine: {reason} Run it as "
            f"root, outside of a container or in a privileged one, or allow user namespaces"
        )


def _alone() -> list[str]:
    # the other namespaces need root, which an ordinary user is only in a user namespace
    root = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", *root, "--ipc", "--mount", "--net", "--pid", "--fork", "--kill-child", "--mount-proc"]


def session(folder: Path, components: Sequence[Path], run: str, patience: float = 60.0) -> str:
    """Install components in a session, run a bash command in a folder, and return the output.

    components  .comp files, each with its include files in the same folder; they are copied into the folder
    patience    timeout in s, after which all processes are killed

    Raises MissingProgramError if LinuxCNC is not installed, and HalError if the session cannot be isolated, fails or
    times out.
    """
    script = _written(folder, components, run)
    status, printed = _ran(script, patience)
    for _ in range(_AGAIN):
        if status != 0 and _LATE in printed:
            status, printed = _ran(script, patience)
    if status == 0:
        return printed
    raise HalError(f"LinuxCNC failed with status {status}; it said:\n{printed[-3000:]}")


def _written(folder: Path, components: Sequence[Path], run: str) -> Path:
    """Write the script of a session into its folder, with the components, and return its path."""
    check_session()
    for component in components:
        for file in component.parent.iterdir():
            if file.suffix in (".comp", ".h") and file.parent != folder:
                # with its time: what was compiled from it in an earlier session of this folder is still good
                shutil.copy2(file, folder / file.name)
    names = " ".join(component.name for component in components)
    user = _NOBODY if os.geteuid() == 0 else _USER
    script = folder / "session.sh"
    script.write_text(_SESSION.format(modules=MODULES, components=names, user=user), encoding="utf-8")
    (folder / "run.sh").write_text(f"{run}\n", encoding="utf-8")
    return script


def _ran(script: Path, patience: float) -> tuple[int, str]:
    """Run the script of a session; return its exit status and output."""
    program = subprocess.Popen(
        [*_alone(), "bash", script.name],
        cwd=script.parent,
        text=True,
        encoding="utf-8",
        errors="replace",
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        printed, _ = program.communicate(timeout=patience)
    # Ctrl-C, too, must not leave real-time processes running
    except BaseException as error:
        os.killpg(program.pid, signal.SIGKILL)
        printed, _ = program.communicate()
        if isinstance(error, subprocess.TimeoutExpired):
            raise HalTimeoutError(
                f"LinuxCNC did not end within {Quantity(patience, 's'):6 SI}; it said:\n{printed[-2000:]}", printed
            ) from None
        raise
    return program.returncode, printed


# LinuxCNC waits three seconds for its own master process, which a busy machine may exceed: then it is repeated.
_LATE, _AGAIN = "Waited 3 seconds for master", 4

# A tmpfs over the component folder holds copies of the components, new installations, and the processes' socket.
# LinuxCNC communicates internally over the loopback device, which is off in a new network namespace.
_SESSION = """\
set -e
/usr/bin/python3 - <<'END'
import fcntl, socket, struct
fcntl.ioctl(socket.socket(), 0x8914, struct.pack("16sH14x", b"lo", 0x41))  # SIOCSIFFLAGS: up and running
END
mkdir -p stock
cp {modules}/*.so stock
mount -t tmpfs -o mode=1777 feeddrive {modules}
cp stock/*.so {modules}
rm -r stock
for each in {components}; do
    made=${{each%.comp}}.so
    [ $made -nt $each ] || halcompile --compile $each
    cp $made {modules}
done
export RTAPI_FIFO_PATH={modules}/socket HOME=$PWD
{user} bash run.sh
"""
_NOBODY = "RTAPI_UID=65534"  # LinuxCNC does not run as root: the user id is passed to it
_USER = "unshare --user --map-user=1000"  # and the root of these namespaces can only become a user again


STREAMER_PINS = 20  # MAX_PINS in LinuxCNC's streamer.h, of one streamer and of one sampler
STREAMERS = 8  # MAX_STREAMERS there


def stream_pin(i: int) -> str:
    """Return the HAL pin of input i of a run; the last pin of each streamer marks rows that are valid."""
    return f"streamer.{i // (STREAMER_PINS - 1)}.pin.{i % (STREAMER_PINS - 1)}"


@dataclass(frozen=True, eq=False)
class HalRun:
    """The result of a HAL run: the recorded rows of numbers, one per sample, and the printed output."""

    rows: np.ndarray
    printed: str


def halrun(
    components: Sequence[Path],
    folder: Path,
    period: int,
    wiring: Sequence[str],
    samples: np.ndarray,
    types: str,
    taken: str,
    *,
    meanwhile: Sequence[str] = (),
    at_end: Sequence[str] = (),
    paced: bool = False,
    patience: float = 60.0,
) -> HalRun:
    """Install components, stream rows of inputs through them, one per servo period, and record the rows of outputs.

    components  .comp files, each with its include files in the same folder
    folder      an empty folder for intermediate files
    period      period of the thread `servo-thread`, ns
    wiring      halcmd commands that load and add components between streamer and sampler, and connect
                `stream_pin(i)` of input i and `sampler.0.pin.N`
    samples     the input rows, shape (n, len(types))
    types       types of the input pins, one letter each: f float, b bit, s signed, u unsigned
    taken       types of the recorded output pins, in the same notation
    meanwhile   halcmd commands to execute after the thread has started;  at_end: after all rows have arrived
    paced       True to run in real time, one row per period, as on a machine
    patience    timeout of the run in s

    Raises MissingProgramError if LinuxCNC is not installed, and HalError if the run fails or times out.
    """
    most = STREAMERS * (STREAMER_PINS - 1)
    if not 0 < len(types) <= most or not 0 < len(taken) <= STREAMER_PINS:
        raise ParameterError(
            f"a run in HAL has 1 to {most} numbers in and 1 to {STREAMER_PINS} out, and this one {len(types)} and "
            f"{len(taken)}"
        )
    pieces = [slice(i, i + STREAMER_PINS - 1) for i in range(0, len(types), STREAMER_PINS - 1)]
    for i, piece in enumerate(pieces):
        (folder / f"in{i}.txt").write_text(_rows(samples[:, piece], types[piece]), encoding="utf-8")
    (folder / "drain.py").write_text(_DRAIN, encoding="utf-8")
    lines = [
        f"loadrt threads name1=servo-thread period1={period}",
        f"loadrt streamer depth={','.join([str(len(samples) + 2)] * len(pieces))} "
        f"cfg={','.join(f'{types[piece]}b' for piece in pieces)}",
        f"loadrt sampler depth={len(samples) + 2} cfg={taken}",
        *(f"addf streamer.{i} servo-thread" for i in range(len(pieces))),
        *wiring,
        "addf sampler.0 servo-thread",
        f"net valid streamer.0.pin.{len(types[pieces[0]])} => sampler.0.enable",
        *(f"loadusr -w halstreamer -c {i} in{i}.txt" for i in range(len(pieces))),
        "start",
        *meanwhile,
        f"loadusr -w /usr/bin/python3 drain.py {len(samples)} {patience}",
        *at_end,
        f"loadusr -w /bin/echo {_COMPLETE}",
    ]
    (folder / "run.hal").write_text("\n".join(lines) + "\n", encoding="utf-8")
    try:
        printed = session(folder, components, run_line(folder, paced=paced), patience)
    except HalTimeoutError as late:
        # once in many thousand runs LinuxCNC's own exit hangs: all rows and answers are there by then
        if _COMPLETE not in late.printed:
            raise
        printed = late.printed
    out = folder / "out.bin"
    rows = np.fromfile(out, dtype="<f8").reshape(-1, len(taken)) if out.exists() else np.empty((0, len(taken)))
    if len(rows) != len(samples):
        raise HalError(f"LinuxCNC's HAL gave {len(rows)} of {len(samples)} samples back; it said:\n{printed[-2000:]}")
    return HalRun(rows, printed.replace(f"{_COMPLETE}\n", ""))


# printed by the last command of a run
_COMPLETE = "feeddrive-run-complete"


def run_line(folder: Path, *, paced: bool) -> str:
    """Return the bash line that runs `run.hal` of the folder; without `paced` no period is waited for."""
    if paced:
        return "halrun -f run.hal"
    (folder / "unpaced.c").write_text(_UNPACED, encoding="utf-8")
    return "gcc -shared -fPIC -O1 -o unpaced.so unpaced.c; LD_PRELOAD=$PWD/unpaced.so halrun -f run.hal"


def _rows(values: np.ndarray, types: str) -> str:
    """Return the rows as text for halstreamer, with all digits.

    An additional last column of ones marks valid rows; a row of zeros follows at the end.
    """
    words = [repr if letter == "f" else _whole for letter in types]
    lines = [
        " ".join([*(word(value) for word, value in zip(words, row, strict=True)), "1"])
        for row in np.asarray(values, dtype=float).tolist()
    ]
    # a streamer holds its last row when the queue is empty: the flag of this one switches the sampler off
    return "\n".join([*lines, " ".join(["0"] * (len(types) + 1))]) + "\n"


def _whole(value: float) -> str:
    return str(int(value))


# a HAL thread waits for its next period by this call
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


class LiveSession:
    """A HAL that stays loaded, with a program inside that does what it is asked: halcmd, and motions.

    folder      a folder for intermediate files, kept as long as the session
    components  .comp files that are installed for the session, each with its include files in the same folder
    lines       halcmd commands that load the components, the threads, a streamer and a sampler
    alone       True for namespaces of its own, which leave the system as it is and reach no hardware; False to run as
                `halrun` does, with the components that are installed
    paced       False to run without waiting for the periods, where nothing real moves

    Raises MissingProgramError if LinuxCNC is not installed, and HalError if HAL does not start.
    """

    def __init__(
        self, folder: Path, components: Sequence[Path], lines: Sequence[str], *, alone: bool, paced: bool
    ) -> None:
        self.folder, self.alone = folder, alone
        (folder / "player.py").write_text(text("player.txt"), encoding="utf-8")
        player = "loadusr -w /usr/bin/python3 player.py"
        (folder / "run.hal").write_text("\n".join([*lines, player]) + "\n", encoding="utf-8")
        run = run_line(folder, paced=paced)
        if alone:
            self._command = [*_alone(), "bash", _written(folder, components, run).name]
        else:
            check_programs()
            (folder / "run.sh").write_text(f"{run}\n", encoding="utf-8")
            self._command = ["bash", "run.sh"]
        self._printed: list[str] = []
        for tried in range(_AGAIN + 1):
            self._begin()
            try:
                self._answer(_PATIENCE)
            except HalError:
                if tried == _AGAIN or not any(_LATE in line for line in self._printed):
                    raise
            else:
                return

    def _begin(self) -> None:
        self._printed.clear()
        self._program = subprocess.Popen(
            self._command,
            cwd=self.folder,
            text=True,
            encoding="utf-8",
            errors="replace",
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            # Ctrl-C is for the program that asks: it brakes the axis
            start_new_session=True,
        )
        self._answers: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._listener = threading.Thread(target=self._listen, args=(self._program, self._answers), daemon=True)
        self._listener.start()

    def _listen(self, program: subprocess.Popen[str], answers: queue.Queue[dict[str, Any] | None]) -> None:
        assert program.stdout is not None
        for line in program.stdout:
            if line.startswith("@@"):
                answers.put(json.loads(line[2:]))
            else:
                self._printed.append(line)
        answers.put(None)

    def _answer(self, patience: float) -> dict[str, Any]:
        """Return the next answer. Raises HalError, with what LinuxCNC said, if none comes."""
        try:
            answer = self._answers.get(timeout=patience)
        except queue.Empty:
            self.close()
            raise HalError(
                f"LinuxCNC did not answer within {Quantity(patience, 's'):6 SI}; it said:\n{self.printed()}"
            ) from None
        if answer is None:
            self.close()
            raise HalError(f"LinuxCNC ended; it said:\n{self.printed()}")
        return answer

    def printed(self) -> str:
        """Return what LinuxCNC printed last, without what it prints when all is well."""
        return "".join(line for line in self._printed if not line.startswith(_USUAL))[-3000:]

    @property
    def runs(self) -> bool:
        """True until the session has ended."""
        return self._program.poll() is None

    def ask(self, **order: object) -> dict[str, Any]:
        """Send an order and return its answer. Raises HalError for one that fails, and if the session has ended."""
        self._send(order)
        return self._checked(self._answer(_PATIENCE))

    def _checked(self, answer: dict[str, Any]) -> dict[str, Any]:
        if answer.get("status", 0) != 0:
            raise HalError(f"LinuxCNC refused: {str(answer['printed']).strip()[-2000:]}")
        return answer

    def _send(self, order: Mapping[str, object]) -> None:
        assert self._program.stdin is not None
        try:
            self._program.stdin.write(f"{json.dumps(order)}\n")
            self._program.stdin.flush()
        except OSError:
            raise HalError(f"LinuxCNC ended; it said:\n{self.printed()}") from None

    def halcmd(self, *lines: str) -> str:
        """Execute halcmd commands and return what they print. Raises HalError with the message of the first failure."""
        file = self.folder / "order.hal"
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return str(self.ask(do="run", command=["halcmd", "-s", "-f", file.name])["printed"])

    def run(self, *command: str) -> str:
        """Run a program in the session and return what it prints. Raises HalError if it fails."""
        return str(self.ask(do="run", command=list(command))["printed"])

    def play(self, stopped: Callable[[int], bool], **order: object) -> dict[str, Any]:
        """Play a motion (see `player.txt`) and return how it ended.

        stopped  called ten times a second with the number of rows that have been played; True brakes the axis
        """
        self._send({"do": "play", **order})
        halted, played = False, 0
        while True:
            try:
                answer = self._answers.get(timeout=0.05)
            except queue.Empty:
                answer = {"played": played}
            if answer is None or "fault" in answer or "status" in answer:
                break
            played = int(answer["played"])
            if stopped(played) and not halted:
                halted = True
                self._send({"do": "stop"})
        if answer is None:
            self.close()
            raise HalError(f"LinuxCNC ended in motion; it said:\n{self.printed()}")
        return self._checked(answer)

    def close(self) -> None:
        """End the session: HAL is unloaded, which switches the drive off."""
        if self._program.stdin is not None:
            with contextlib.suppress(OSError):
                self._program.stdin.close()
        try:
            self._program.wait(_ENDING)
        except subprocess.TimeoutExpired:
            os.killpg(self._program.pid, signal.SIGKILL)
            self._program.wait()
        if threading.current_thread() is not self._listener:
            self._listener.join(_ENDING)
        if self._program.stdout is not None:
            self._program.stdout.close()


_USUAL = ("Running with fallback_uid", "Note: Using POSIX", "Compiling realtime", "Linking ")
_PATIENCE = 60.0  # s for an order to be done; compiling a component is the longest
_ENDING = 10.0  # s for HAL to unload itself


OUTPUTS = {
    "force": ("force-cmd", "f"),
    "command": ("drive-cmd", "f"),
    "trip": ("trip-code", "s"),
    "enabled": ("running", "b"),
}


def output_pin(path: str) -> tuple[str, str]:
    """Return the pin of an output of the routine, and its type."""
    pin, kind = OUTPUTS[quantity(path)]
    return hal(path[: -len(quantity(path))]) + pin, kind


def answers(
    routine: Routine,
    directory: Path,
    folder: Path,
    inputs: np.ndarray,
    *,
    units_per_m: float = 1.0,
    also: Mapping[str, np.ndarray] | None = None,
    more: Sequence[tuple[str, str]] = (),
    setup: Sequence[str] = (),
    meanwhile: Sequence[str] = (),
    at_end: Sequence[str] = (),
    paced: bool = False,
    period: int | None = None,
    patience: float = 60.0,
) -> HalRun:
    """Run an exported controller on inputs in SI units, shape (n, inputs), in the order of the routine; return its
    outputs.

    directory    output directory of `write_linuxcnc`;  folder: an empty working folder
    units_per_m  factor on lengths; with 1 the component receives exactly the numbers of `inputs`
    also         additional bit pins, with their value in each sample
    more         names and types of pins recorded after the outputs, such as ("fault-code", "s")
    setup        halcmd commands to execute before the thread starts; for the other arguments see `halrun`
    period       thread period in ns; default: the sample time

    Raises MissingProgramError and HalError as `halrun` does.
    """
    name = hal(routine.name)
    pins = [*(input_pin(v.path) for v in routine.inputs), *(also or {})]
    taken = [output_pin(v.path) for v in routine.outputs] + list(more)
    wiring = [
        f"loadrt {routine.name}",
        f"addf {name} servo-thread",
        f"setp {name}.units-per-m {units_per_m!r}",
        # a session does not run in real time: late calls are no fault here
        f"setp {name}.late-limit 0",
        *setup,
        *(f"net in-{i} {stream_pin(i)} => {name}.{pin}" for i, pin in enumerate(pins)),
        *(f"net out-{i} {name}.{pin} => sampler.0.pin.{i}" for i, (pin, _) in enumerate(taken)),
    ]
    rows = np.array(inputs, dtype=float)
    for i, variable in enumerate(routine.inputs):
        if quantity(variable.path) == "enable":
            rows[:, i] = rows[:, i] > 0.5
        else:
            rows[:, i] *= units_per_m
    rows = np.column_stack([rows, *(also or {}).values()])
    return halrun(
        [directory / f"{routine.name}.comp"],
        folder,
        period or servo_period(routine),
        wiring,
        rows,
        "".join("b" if pin.rpartition(".")[2] == "enable" or pin in (also or {}) else "f" for pin in pins),
        "".join(kind for _, kind in taken),
        meanwhile=meanwhile,
        at_end=at_end,
        paced=paced,
        patience=patience,
    )


def prove(directory: Path, design: Design, tried: Trial) -> Answers:
    """Build the component in a temporary folder and run a trial in halrun. Raises the errors of `answers`."""
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        ran = answers(design.routine, directory.resolve(), Path(folder), tried.inputs)
    return Answers(ran.rows[:, : len(design.routine.outputs)], "LinuxCNC, halrun", "halcompile --install")
