"""`feeddrive excite`: what to send to an axis to measure its frequency response."""

from __future__ import annotations

from pathlib import Path

from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.identification.excitation.design import design_excitation
from feeddrive.identification.excitation.excitation import Excitation
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.excitation_page import WARNING, write_excitation
from feeddrive.workflow.request import OUT, Request, argument, frequencies, option


class ExciteRequest(Request):
    """Which axis is excited where, in which band, how strongly, and within which limits."""

    machine: str | Path | MachineFile = argument("A machine file (TOML), or the name of a bundled machine")
    band: str = option("Hz, as 5..500")
    amplitude: float = option("peak: N on the force, m on the setpoint")
    axis: str | None = option("the axis, if the machine has several", default=None)
    where: str = option("force or setpoint", default="force")
    resolution: float = option("from line to line", default=1.0, unit="Hz")
    periods: int = option("periods in steady state", default=8, least=2)
    realisations: int = option("repeated with other phases", default=2, least=1)
    grid: str = option("full, odd, odd_odd or random_odd", default="random_odd")
    offset_velocity: float | None = option("under the excitation; found if left out", unit="m/s", default=None)
    travel: float | None = option("limit", unit="m", default=None)
    speed: float | None = option("limit", unit="m/s", default=None)
    force: float | None = option("limit", unit="N", default=None)
    seed: int = option("of grid, phases and noise", default=0)
    out: Path | None = option(OUT, short="-o", default=None)

    @property
    def name(self) -> str:
        """Of the excitation and its directory: that of the machine file, and the axis if it was named."""
        stem = Path(self.machine.file.name if isinstance(self.machine, MachineFile) else self.machine).stem
        return f"{stem}{'' if self.axis is None else f'_{self.axis}'}"

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / f"excite_{self.name}"


@command(ExciteRequest)
def excite(request: ExciteRequest, progress: Progress) -> Outcome[Excitation]:
    """Design a multisine and check travel, speed and force by simulation; files to be sent are written if asked for.

    Raises ParameterError for a band, a grid or a limit that cannot be kept.
    """
    machine = request.machine if isinstance(request.machine, MachineFile) else read_machine(request.machine)
    loop = machine.loop(request.axis)
    progress.step("designing and simulating")
    found = design_excitation(
        loop, band=frequencies(request.band), name=request.name, amplitude=request.amplitude, where=request.where,
        resolution=request.resolution, periods=request.periods, grid=request.grid, realisations=request.realisations,
        offset_velocity=request.offset_velocity, travel=request.travel, speed=request.speed, force=request.force,
        seed=request.seed,
    )  # fmt: skip
    files: dict[str, str] = {}
    if request.out is not None:
        progress.step("report")
        facts = {"Machine": machine.name, "Source of its numbers": machine.source or "not stated"}
        report = write_excitation(found, loop, request.out, facts)
        files["Report"] = f"{report}, to be sent: {report.parent / 'excitation_1.csv'}"
    return Outcome(found, [found.table()], [*found.remarks, WARNING], files=files)
