"""The HAL of an axis that motions are played on: what is loaded, how it is wired, and what runs in it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
import tempfile
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.export.c_code import texts
from feeddrive.export.layout import layout
from feeddrive.export.linuxcnc import controller_comp, core, hal, input_pin, parameter
from feeddrive.export.linuxcnc import text as template
from feeddrive.export.linuxcnc_file import LinuxcncFile
from feeddrive.export.linuxcnc_session import MODULES, HalError, LiveSession
from feeddrive.language.errors import BusError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.routine import Routine

HANDOVER = 0.1  # s in which the difference of two controls fades away: slower than the loops, which follow it
AHEAD = 0.5  # s of rows that are fed ahead: a program that fails lets the axis go on for so long before it brakes
DEPTH = 65_536  # rows that streamer and sampler hold: a second at the fastest thread, and more
LONGEST = 524_288  # rows of virtual time, which all stand in the queue when they are played
NO_END = 1e30  # a position that no axis reaches
EXCITE, TRIAL = "feeddrive_excite", "feeddrive_trial"

# streamer: number of the row, set motion, excitation, and what the row does
FED, _KINDS = ("row", "position", "velocity", "acceleration", "excitation", "new", "log", "last"), "uffffbbb"
# pins of the component that are written, and those of them that are recorded by the place in the sampler
_WRITTEN = (
    *("set-position", "set-velocity", "set-acceleration", "old-enable", "new-enable", "drive-enable", "brake-open"),
    *("off", "command", "force", "control-force", "excitation", "handover", "active", "logging", "streaming"),
)
_RECORDED = {0: "set-position", 1: "excitation", 2: "force", 3: "control-force", 4: "handover", 7: "active"}
_TAKEN = "fffffffu"


class AxisHal:
    """The HAL of an axis: loaded when it is needed first, and then kept; the axes made of one another share it."""

    def __init__(self, file: LinuxcncFile, folder: Path, *, paced: bool) -> None:
        self.file, self.folder, self.paced = file, folder, paced
        self._loaded = ""
        self.work = Path(tempfile.mkdtemp(prefix="feeddrive-hal-"))
        # the running session, in a list that outlives this object
        self._sessions: list[LiveSession] = []
        weakref.finalize(self, _ended, self._sessions, self.work)

    @property
    def session(self) -> LiveSession:
        """The session, begun if there is none. Raises BusError, with what LinuxCNC said, if it fails."""
        if self._runs:
            return self._sessions[0]
        self.close()
        work, file = self.work, self.file
        if not (work / f"{EXCITE}.comp").exists():
            (work / f"{EXCITE}.comp").write_text(template(f"{EXCITE}.comp"), encoding="utf-8")
        ini = f"-i {_quoted(self.folder / file.ini)} " if file.ini else ""
        user = f"cd {_quoted(self.folder)} && halcmd {ini}-f {_quoted(self.folder / file.hal)}\n"
        (work / "user.sh").write_text(user, encoding="utf-8")
        components = [work / f"{EXCITE}.comp", *(self.folder / name for name in file.components.split())]
        depth = LONGEST if not self.paced else DEPTH
        lines = [
            "loadusr -w bash user.sh",
            f"loadrt streamer depth={depth} cfg={_KINDS}",
            f"loadrt sampler depth={depth} cfg={_TAKEN}",
            f"loadrt {EXCITE}",
        ]
        self._loaded = ""
        try:
            if not file.simulated:
                _install(work / f"{EXCITE}.comp")
            session = LiveSession(work, components, lines, alone=file.simulated, paced=self.paced)
            self._sessions.append(session)
            self._wire(session)
            if self.paced:
                session.halcmd("start")
        except HalError as error:
            self.close()
            raise BusError(f"LinuxCNC, axis {file.axis}: {error}") from None
        return session

    @property
    def _runs(self) -> bool:
        return bool(self._sessions) and self._sessions[0].runs

    def _wire(self, session: LiveSession) -> None:
        """Put the component between the control of the axis, its drive and its thread."""
        file, e = self.file, hal(EXCITE)
        version, own = f"{e}.version", re.search(r"version = (\d+)", template(f"{EXCITE}.comp"))
        assert own is not None
        loaded = session.ask(do="values", names=[version])["values"][version]
        if loaded != int(own[1]):
            raise HalError(
                f"the installed {EXCITE} has version {loaded:g}, and this feeddrive needs {own[1]}: "
                f"sudo halcompile --install {session.folder / EXCITE}.comp"
            )
        first, write = self._place(session, file.first), self._place(session, file.write)
        if first >= write:
            raise HalError(
                f"the thread calls {file.first} (first) after {file.write} (write): name the first function of the "
                "control, and the one that passes the command on to the drive"
            )
        functions = [
            f"addf {e}.act {file.thread} {write}",
            f"addf sampler.0 {file.thread} {write + 1}",
            f"addf streamer.0 {file.thread} {first}",
            f"addf {e}.set {file.thread} {first + 1}",
        ]
        read = {
            "position-fb": self._signal(session, file.position, "fd-position-fb"),
            "old-command": self._signal(session, file.output, "fd-old-command"),
        }
        for pin, source in (("drive-fault", file.drive_fault), ("stop", file.stop)):
            if source:
                read[pin] = self._signal(session, source, f"fd-{pin}")
        nets = [f"net {signal} => {e}.{pin}" for pin, signal in read.items()]
        nets += [f"net fd-{pin} {e}.{pin}" for pin in _WRITTEN]
        nets += [f"net fd-{pin} => sampler.0.pin.{i}" for i, pin in _RECORDED.items()]
        nets.append(f"net {read['position-fb']} => sampler.0.pin.5")
        if file.motor_position:
            nets.append(f"net {self._signal(session, file.motor_position, 'fd-motor-position')} => sampler.0.pin.6")
        nets += ["net fd-logging => sampler.0.enable", "net fd-streaming => streamer.0.enable"]
        nets += [f"net fd-row-{i} streamer.0.pin.{i} => {e}.{_row_pin(name)}" for i, name in enumerate(FED)]
        taken = {
            "set-position": file.set_position,
            "set-velocity": file.set_velocity,
            "set-acceleration": file.set_acceleration,
            "old-enable": file.control_enable,
            "drive-enable": file.drive_enable,
            "brake-open": file.brake,
            "command": file.command,
            "force": file.force,
            "off": file.held,
        }
        for source, pins in taken.items():
            nets += [line for pin in pins.split() for line in (f"unlinkp {pin}", f"net fd-{source} => {pin}")]
        session.halcmd(*functions, *nets)

    def _functions(self, session: LiveSession) -> list[str]:
        printed = session.run("halcmd", "show", "thread", self.file.thread)
        found = re.search(rf"^\s*(\d+)\s+\S+\s+{re.escape(self.file.thread)}\b", printed, re.MULTILINE)
        if found is None:
            raise HalError(f"there is no thread '{self.file.thread}' after {self.file.hal}")
        wanted = round(1e9 * self.file.period)
        # the tolerance of the exported component
        if abs(int(found[1]) - wanted) > max(wanted // 1000, 1):
            there, said = Quantity(float(found[1]) * 1e-9, "s"), Quantity(self.file.period, "s")
            raise HalError(
                Text(
                    f"the thread '{self.file.thread}' has a period of {there:6 us}, and the file of the axis says "
                    f"period = {said:6 us}"
                )
            )
        return re.findall(r"^ +\d+ +(\S+)$", printed, re.MULTILINE)

    def _place(self, session: LiveSession, function: str) -> int:
        """Return the place of a function in the thread, from 1 on."""
        functions = self._functions(session)
        if function not in functions:
            raise HalError(
                f"the thread '{self.file.thread}' has no function '{function}'; it has {', '.join(functions) or 'none'}"
            )
        return functions.index(function) + 1

    def _signal(self, session: LiveSession, pin: str, name: str) -> str:
        """Return the signal that a pin is linked to; one of this name is made for a pin without."""
        for line in session.run("halcmd", "-s", "show", "pin", pin).splitlines():
            words = line.split()
            if pin in words:
                if words[-2] in ("==>", "<==", "<=>"):
                    return words[-1]
                session.halcmd(f"net {name} {pin}")
                return name
        raise HalError(f"there is no pin '{pin}' after {self.file.hal}")

    def limit(self, file: LinuxcncFile) -> None:
        """Write scaling and limits into the component, and read them back (BusError)."""
        limits, units = file.limits, float(file.units_per_m)
        values: dict[str, float] = {
            "force-per-unit": file.force_per_output,
            "travel-limit": units * limits.travel,
            "velocity-limit": units * limits.velocity,
            "force-limit": limits.force,
            "error-limit": units * limits.following_error,
            "deceleration": units * limits.quick_stop_deceleration,
            "position-least": -NO_END if limits.position_least is None else units * limits.position_least,
            "position-most": NO_END if limits.position_most is None else units * limits.position_most,
            "brake-time": file.brake_time,
            "handover-rows": round(HANDOVER / file.period),
        }
        self.write({f"{hal(EXCITE)}.{name}": float(value) for name, value in values.items()})

    def write(self, values: Mapping[str, float]) -> None:
        """Set pins and parameters, and read them back; all are restored if one of them is not taken (BusError)."""
        before = self.values(list(values))
        try:
            self._halcmd(*(f"setp {name} {_word(value)}" for name, value in values.items()))
            for name, found in self.values(list(values)).items():
                if float(found) != values[name]:
                    raise BusError(f"LinuxCNC: {name} was set to {values[name]!r} and reads back as {found}")
        except BusError:
            with contextlib.suppress(BusError):
                # one after the other: that which is linked cannot be set, and was not changed
                for name, value in before.items():
                    self._halcmd(f"-setp {name} {_word(float(value))}")
            raise

    def values(self, names: Sequence[str]) -> dict[str, str]:
        """Return the values of pins and parameters, with all digits."""
        if not names:
            return {}
        try:
            answer = self.session.ask(do="values", names=list(names))
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None
        return {name: repr(float(value)) for name, value in answer["values"].items()}

    def _halcmd(self, *lines: str) -> str:
        try:
            return self.session.halcmd(*lines)
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None

    def load(self, routine: Routine, units: float) -> None:
        """Load a control on trial beside that of the axis, off. Raises BusError if LinuxCNC does not take it."""
        made = controller_comp(routine, "A control on trial", "Made by feeddrive.")
        header = core(TRIAL, texts(layout(routine), "A control on trial", ""))
        digest = hashlib.sha256(f"{made}{header}{units}".encode()).hexdigest()
        # a session that begins has none loaded
        session, name, e = self.session, hal(TRIAL), hal(EXCITE)
        if self._loaded == digest:
            return
        self.unload()
        for suffix, content in (("comp", made), ("h", header)):
            (session.folder / f"{TRIAL}.{suffix}").write_text(content, encoding="utf-8")
        try:
            session.run("halcompile", "--install", f"{TRIAL}.comp")
        except HalError as error:
            raise BusError(
                f"LinuxCNC, axis {self.file.axis}: the control on trial could not be installed in {MODULES}: run this "
                f"program as root, or make that folder writable for the commissioning; {error}"
            ) from None
        place = self._place(session, f"{e}.act")
        # in virtual time no call is late
        late = self.file.late if self.paced else 0.0
        sources = {v.path: self._source(session, v.path) for v in routine.inputs}
        self._halcmd(
            f"loadrt {TRIAL}",
            f"setp {name}.units-per-m {units!r}",
            *([] if late is None else [f"setp {name}.late-limit {round(1e9 * late)}"]),
            f"addf {name} {self.file.thread} {place}",
            *(f"net {signal} => {name}.{input_pin(path)}" for path, signal in sources.items() if signal),
            f"net fd-new-force {name}.force-cmd => {e}.new-force",
            f"net fd-new-fault {name}.fault => {e}.new-fault",
            f"net fd-new-running {name}.running => {e}.new-running",
        )
        # what the loaded component says of itself: no other machine's control is tried
        wanted = {f"{name}.{parameter(v, routine).name}": float(v.value) for v in routine.parameters}
        for pin, value in self.values(list(wanted)).items():
            if float(value) != wanted[pin]:
                self.unload()
                raise BusError(f"LinuxCNC: {pin} of the loaded control is {value}, and {wanted[pin]!r} was exported")
        self._loaded = digest

    def _source(self, session: LiveSession, path: str) -> str:
        """Return the signal for an input of the control on trial; an empty string for jerk and snap, which are 0."""
        if path == "reading_motor":
            return self._signal(session, self.file.motor_position, "fd-motor-position")
        if path.startswith("reading"):
            return self._signal(session, self.file.position, "fd-position-fb")
        fixed = {
            "set_position": "fd-set-position",
            "set_velocity": "fd-set-velocity",
            "set_acceleration": "fd-set-acceleration",
            "enable": "fd-new-enable",
        }
        return fixed.get(path, "")

    def unload(self) -> None:
        """Unload the control on trial, if one is loaded."""
        if self._runs and TRIAL in self._halcmd("list comp").split():
            # what the signals held must not stay at the pins
            pins = ("new-force", "new-fault", "new-running")
            lines = [line for pin in pins for line in (f"delsig fd-{pin}", f"setp {hal(EXCITE)}.{pin} 0")]
            self._halcmd(f"unloadrt {TRIAL}", *lines)
        self._loaded = ""

    def play(
        self, rows: np.ndarray, stopped: Callable[[int], bool], T: float, *, listens: bool
    ) -> tuple[dict[str, Any], np.ndarray]:
        """Play rows; return how the motion ended, and what was recorded, shape (n, recorded pins)."""
        session, e = self.session, hal(EXCITE)
        if not self.paced and len(rows) >= LONGEST:
            raise ParameterError(
                f"a motion of {len(rows)} rows is longer than the {LONGEST} that a simulated axis plays at once"
            )
        file, out = session.folder / "rows.bin", session.folder / "taken.bin"
        rows.astype("<f8").tofile(file)
        try:
            session.ask(do="clear", standing=not self.paced)
            session.halcmd(f"setp {e}.listens {int(listens)}")
            ended = session.play(
                stopped,
                rows=file.name,
                types=_KINDS,
                recorded=len(_TAKEN),
                out=out.name,
                lead=max(1, round(AHEAD / T)) if self.paced else len(rows),
                standing=not self.paced,
                patience=len(rows) * T + 30.0,
            )
        except HalError as error:
            raise BusError(f"LinuxCNC, axis {self.file.axis}: {error}") from None
        if self._loaded:
            code = f"{hal(TRIAL)}.fault-code"
            ended["trial"] = int(float(self.values([code])[code]))
        return ended, np.fromfile(out, dtype="<f8").reshape(-1, len(_TAKEN))

    def close(self) -> None:
        """End the session, if there is one."""
        while self._sessions:
            self._sessions.pop().close()


def _install(component: Path) -> None:
    """Install the component where this user may, else check that it is. Raises HalError with what to do."""
    if os.access(MODULES, os.W_OK):
        done = subprocess.run(
            ["halcompile", "--install", component.name],
            cwd=component.parent,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise HalError(f"halcompile failed:\n{done.stdout}{done.stderr}")
    elif not (Path(MODULES) / f"{component.stem}.so").exists():
        raise HalError(
            f"{component.stem} is not installed, which plays the motions: sudo halcompile --install {component}"
        )


def _ended(sessions: list[LiveSession], work: Path) -> None:
    while sessions:
        sessions.pop().close()
    shutil.rmtree(work, ignore_errors=True)


def _row_pin(name: str) -> str:
    return name if name == "row" else f"row-{name}"


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("'", "'\\''") + "'"


def _word(value: float) -> str:
    # pins of whole numbers and bits take no point
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
