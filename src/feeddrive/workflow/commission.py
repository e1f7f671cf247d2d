"""`feeddrive commission`: from an unknown drive to a proven loop that runs; the steps are in `commission_steps`."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from feeddrive.bus.drive_file import DriveFile, read_drive
from feeddrive.bus.gantry import Gantry, GantryMotion
from feeddrive.bus.live import BusAxis, LiveAxis, virtual_bus_axis
from feeddrive.bus.virtual_gantry import beam_of, virtual_gantry
from feeddrive.commissioning.record import Commissioned
from feeddrive.export.linuxcnc_axis import LinuxcncAxis
from feeddrive.export.linuxcnc_file import read_linuxcnc_file
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.toml_file import read_toml
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.commission_gantry import GantryChain
from feeddrive.workflow.commission_steps import Chain, CommissionRequest


@command(CommissionRequest)
def commission(request: CommissionRequest, progress: Progress) -> Outcome[Commissioned]:
    """Take a drive from unknown to a proven loop that runs: sign, mass, responses, model, tuning, export and a trial.

    Every step that moves the axis says what it will do and asks.  The control that the drive has stays in place until
    the trial of the new one is as predicted, and the user keeps it.  An interrupted commissioning goes on where it was.

    The result is a `Commissioned`; a reason to stop is its `refusal`.  Raises BusError and AbortedError for a drive
    that cannot be commanded, ParameterError for limits that are too narrow.
    """
    axis = _in_mode(live_axis(request), request.mode)
    if request.yes and not axis.is_virtual:
        raise ParameterError(f"--yes is for a virtual drive only: {axis.where} may move something real")
    chain = _chain(axis)
    chain.check(request)
    if request.out is None:
        with TemporaryDirectory() as folder:
            return chain(request, axis, Path(folder), progress).run(kept=False)
    return chain(request, axis, request.out, progress).run(kept=True)


def _chain(axis: LiveAxis) -> type[Chain]:
    """Return the steps for an axis."""
    if isinstance(axis, GantryMotion):
        return GantryChain
    if axis.commanded == "velocity":
        # with what fits the velocity loop, which no other drive needs
        from feeddrive.workflow.commission_velocity import VelocityChain

        return VelocityChain
    return Chain


def _in_mode(axis: LiveAxis, mode: str | None) -> LiveAxis:
    """Return the axis with the mode of the request. Raises ParameterError for an axis that has no such modes."""
    if mode is None or (mode == "cst" and not isinstance(axis, BusAxis)):
        return axis
    if not isinstance(axis, BusAxis):
        raise ParameterError(
            f"--mode {mode}: {axis.where} is no CiA 402 drive of one axis, and takes forces alone: leave it out"
        )
    return axis.in_mode(mode)


def live_axis(request: CommissionRequest) -> LiveAxis:
    """Return the axis that a request names: of a drive, of both drives of a gantry, or a virtual one."""
    if request.virtual is not None:
        return virtual_axis(request.virtual)
    assert request.drive is not None
    if request.second is None:
        return _axis_of(request.drive)
    first, second = _axis_of(request.drive), _axis_of(request.second)
    if not (isinstance(first, BusAxis) and isinstance(second, BusAxis)):
        raise ParameterError("--second: the two drives of a gantry are CiA 402 drives on one EtherCAT segment")
    for axis in (first, second):
        if axis.commanded != "force":
            raise ParameterError(
                f'{axis.file.name}: mode = "csv": the drives of a gantry are controlled by forces: write mode = "csp"'
            )
    return Gantry(first, second).common


def _axis_of(drive: str | Path | DriveFile | LiveAxis) -> LiveAxis:
    """Return the axis of a drive file, of the file of an axis of LinuxCNC, or as it is."""
    if isinstance(drive, DriveFile):
        return BusAxis(drive)
    if not isinstance(drive, str | Path):
        return drive
    if isinstance(read_toml(drive).content.get("hal"), str):
        return LinuxcncAxis(read_linuxcnc_file(drive))
    return BusAxis(read_drive(drive))


def virtual_axis(machine: MachineLike) -> LiveAxis:
    """Return a virtual drive with the plant of a machine file, or both drives of a gantry, in virtual time."""
    file = read_machine(machine)
    whole = file.machine() if file.couplings else None
    if whole is not None and beam_of(whole) is not None:
        return virtual_gantry(whole).common
    return virtual_bus_axis(file.loop(None))
