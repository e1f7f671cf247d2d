"""`feeddrive follow`: wait for a trigger in signals that are being recorded, and save the window around it as a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from feeddrive.analysis.oscilloscope import RISING, SINGLE, LiveSource, Oscilloscope, Shown, Trigger
from feeddrive.files.growing import GrowingBytes, GrowingFile, GrowingTable, Pipe
from feeddrive.files.log import Log, write_log
from feeddrive.files.read_log import checked_clock
from feeddrive.language.errors import FileError, LogError, ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.workflow.command import OUT_FILE, Outcome, Request, argument, command, option

PIPE = "-"
_OFTEN = 0.02  # s, polling interval
_NO_CLOCK = "{name}: has no clock: give the sample time, so that its rows have times in s"


class FollowRequest(Request):
    """The source to follow, the trigger, the window to save, and the timeout."""

    source: Path = argument(
        "A table in text that grows, as a log that is being written; - for rows from a pipe, as of halsampler; or the "
        "drive file (TOML) of a drive, which is sampled and neither enabled nor moved"
    )
    channel: str | None = option("channel that triggers; none: the first complete window is kept", default=None)
    level: float = option("trigger level, in the unit of the channel", default=0.0)
    edge: str = option("direction in which the channel passes the level", default=RISING, options=("rising", "falling"))
    hysteresis: float = option(
        "distance beyond the level on the other side that arms the trigger, in the channel's unit",
        default=0.0,
        least=0.0,
    )
    hold: float = option("time after a trigger in which no other one counts", default=0.0, unit="s", least=0.0)
    window: float = option("length of the window", default=1.0, unit="s", least=1e-4)
    before: float = option("share of the window before the trigger", default=0.2, least=0.0, most=0.95)
    sample_time: float | None = option(
        "sample time of a table without a column of time", default=None, unit="s", above=0.0, most=10.0
    )
    time_unit: str | None = option(
        "unit of a column of time that states none; default: s", default=None, options=("s", "ms", "us", "ns")
    )
    timeout: float = option("time without a window after which the command ends", default=60.0, unit="s", above=0.0)
    out: Path | None = option(OUT_FILE + "; .parquet", short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"window_{'pipe' if str(self.source) == PIPE else self.source.stem}.parquet"

    def trigger(self) -> Trigger | None:
        """Return the requested trigger; None if no trigger channel is given."""
        if self.channel is None:
            return None
        return Trigger(self.channel, self.level, self.edge, self.hysteresis, self.hold)


@command(FollowRequest)
def follow(request: FollowRequest, progress: Progress) -> Outcome[Log]:
    """Wait for the trigger in signals that are being recorded, and save the window around it as a log.

    Raises FileError, LogError or BusError for a source that cannot be followed, and LogError on a timeout.
    """
    pipe = Pipe(sys.stdin.buffer) if str(request.source) == PIPE else None
    source = opened(request.source, pipe, sample_time=request.sample_time, time_unit=request.time_unit)
    scope = Oscilloscope(request.window, request.before, SINGLE, request.trigger())
    until, reported = time.monotonic() + request.timeout, ""
    try:
        while True:
            came = scope.feed(source)
            check_channel(scope)
            # without channels no row has come yet, and the clock is not known
            if scope.channels and source.clock != "s":
                raise ParameterError(_NO_CLOCK.format(name=source.name))
            shown = scope.caught if scope.trigger is not None else scope.last()
            if shown is not None and shown.whole:
                break
            if scope.lack:
                raise ParameterError(f"{source.name}: {scope.lack}")
            state = source.state()
            if state != reported:
                progress.step(f"{source.name}: {state}")
                reported = state
            progress.check()
            # the last rows may still complete a window: a source has ended only once it gives none
            if time.monotonic() > until or (source.over and not came):
                within = "" if source.over else Text(f" within {Quantity(request.timeout, 's'):6 SI}")
                raise LogError(
                    f"{source.name}: no window came{within} ({state}; {scope.rows} rows in all): look at level, "
                    "channel and length of the window" + ("" if source.over else ", or give a longer --timeout")
                )
            time.sleep(_OFTEN)
    finally:
        source.close()
    log = window_log(f"{source.name}, window", shown)
    files = dict[str, str | Path]()
    if request.out is not None:
        request.out.parent.mkdir(parents=True, exist_ok=True)
        write_log(request.out, log)
        files["Log"] = request.out
    at = (
        Text(f"triggered at {Quantity(shown.zero, 's'):6 SI}")
        if shown.triggered
        else Text(f"until {Quantity(shown.zero, 's'):6 SI}")
    )
    return Outcome(log, [log.table()], [f"{at} of the clock of {source.name}", *log.remarks], files=files)


def opened(
    source: Path,
    pipe: Pipe | None = None,
    *,
    sample_time: float | None = None,
    time_unit: str | None = None,
    inside: Path | None = None,
) -> LiveSource:
    """Open a live source by name: `-` is the pipe, a drive file is its drive, any other name a table being written.

    inside  a folder in which the table must lie; None: anywhere

    Raises FileError and ParameterError for an invalid drive file. A missing table is accepted if its folder exists:
    the source then waits for it.
    """
    # a file that a page offers from its folder must never open a bus, whatever its suffix
    if source.suffix.lower() == ".toml" and inside is None:
        from feeddrive.bus.drive_file import read_drive
        from feeddrive.bus.sampling import DriveSamples

        return DriveSamples(read_drive(source))
    if pipe is None:
        check_followed([source])
    content: GrowingBytes = GrowingFile(source, inside) if pipe is None else pipe.follower()
    return GrowingTable(content, sample_time=sample_time, time_unit=time_unit)


def check_followed(sources: Collection[Path]) -> None:
    """Raise FileError or ParameterError for a source that can never be followed, such as an invalid drive file."""
    for source in sources:
        if source.suffix.lower() == ".toml":
            from feeddrive.bus.drive_file import read_drive

            read_drive(source)
        elif str(source) != PIPE and (source.is_dir() or not source.parent.is_dir()):
            wrong = "is a folder: name a table in it" if source.is_dir() else f"there is no folder {source.parent}"
            raise FileError(f"{source}: {wrong}")


def check_channel(scope: Oscilloscope) -> None:
    """Raise ParameterError if the source lacks the trigger channel."""
    if scope.trigger is not None and scope.channels and scope.trigger.channel not in scope.channels:
        name = scope.trigger.channel
        raise ParameterError(f"there is no channel '{name:.60}' to trigger by{nearest(name, scope.channels)}")


def window_log(
    name: str, shown: Shown, stated: Mapping[str, str] | None = None, channels: Collection[str] | None = None
) -> Log:
    """Return a window as a log whose time is 0 at the trigger or, without a trigger, at the end of the window.

    stated    units of channels whose source states none
    channels  channels to keep; None: all

    Raises LogError, which states the position, for a gap or a non-uniform clock, and ParameterError for a source
    without a clock.
    """
    if shown.clock != "s":
        raise ParameterError(_NO_CLOCK.format(name=name))
    units = {channel: unit or (stated or {}).get(channel, "") for channel, unit in shown.channels.items()}
    names = [channel for channel in units if channels is None or channel in channels]
    values = {channel: shown.values[:, k] for k, channel in enumerate(units) if channel in names}
    # overruns and lost frames are recorded as NaN
    lost = np.flatnonzero(np.any([~np.isfinite(row) for row in values.values()], axis=0)) if values else np.empty(0)
    if lost.size:
        at = float(shown.time[int(lost[0])]) - shown.zero
        raise LogError(
            f"{name}: has {lost.size} gap{'s' * (lost.size != 1)}, the first at {Quantity(at, 's'):6 SI}; keep a "
            "window without one: between the cursors, or a shorter one"
        )
    time = shown.time - shown.zero
    clock = checked_clock(name, time, lambda row: Text(f"{Quantity(time[row], 's'):6 SI}"))
    return Log(
        name=name,
        time=time,
        channels=values,
        units={channel: units[channel] for channel in names},
        sample_time=clock.sample_time,
        jitter=clock.jitter,
        provenance={"written_by": "feeddrive follow", "zero": shown.zero, "triggered": shown.triggered},
    )


def between(shown: Shown, a: float, b: float) -> Shown:
    """Return the part of a window from time `a` to `b` in s, on the window's time axis.

    Raises ParameterError if that part is empty.
    """
    low, high = min(a, b), max(a, b)
    # cursors are set in the time of the picture, which is 0 at the trigger
    kept = (shown.time - shown.zero >= low) & (shown.time - shown.zero <= high)
    if not kept.any():
        raise ParameterError(
            f"nothing was recorded between the cursors at {Quantity(low, 's'):6 SI} and {Quantity(high, 's'):6 SI}"
        )
    return replace(shown, time=shown.time[kept], values=shown.values[kept], start=low, end=high)
