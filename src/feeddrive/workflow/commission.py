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
    axis = _axis(request)
    if request.yes and not axis.is_virtual:
        raise ParameterError(f"--yes is for a virtual drive only: {axis.where} may move something real")
    chain = GantryChain if isinstance(axis, GantryMotion) else Chain
    if request.out is None:
        with TemporaryDirectory() as folder:
            return chain(request, axis, Path(folder), progress).run(kept=False)
    return chain(request, axis, request.out, progress).run(kept=True)


def _axis(request: CommissionRequest) -> LiveAxis:
    if request.virtual is not None:
        return virtual_axis(request.virtual)
    assert request.drive is not None
    if request.second is None:
        return _axis_of(request.drive)
    first, second = _axis_of(request.drive), _axis_of(request.second)
    if not (isinstance(first, BusAxis) and isinstance(second, BusAxis)):
        raise ParameterError("--second: the two drives of a gantry are CiA 402 drives on one EtherCAT segment")
    return Gantry(first, second).common


def _axis_of(drive: str | Path | DriveFile | LiveAxis) -> LiveAxis:
    """Return the axis of a drive file, of the file of an axis of LinuxCNC, or as it is."""
    if isinstance(drive, DriveFile):
        return _on_bus(drive)
    if not isinstance(drive, str | Path):
        return drive
    if isinstance(read_toml(drive).content.get("hal"), str):
        return LinuxcncAxis(read_linuxcnc_file(drive))
    return _on_bus(read_drive(drive))


def _on_bus(file: DriveFile) -> BusAxis:
    """Return the axis of a drive file. Raises ParameterError for csv: the plant of a loop there is a velocity loop."""
    if file.drive.mode == "csv":
        raise ParameterError(
            f'{file.name}: mode = "csv": commission closes its loops by force (cst), or by gains in the drive '
            '([gains]): write mode = "csp"'
        )
    return BusAxis(file)


def virtual_axis(machine: MachineLike) -> LiveAxis:
    """Return a virtual drive with the plant of a machine file, or both drives of a gantry, in virtual time."""
    file = read_machine(machine)
    whole = file.machine() if file.couplings else None
    if whole is not None and beam_of(whole) is not None:
        return virtual_gantry(whole).common
    return virtual_bus_axis(file.loop(None))
