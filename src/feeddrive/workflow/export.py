"""`feeddrive export` and `feeddrive verify`: code for a target, and its comparison with the simulator."""

from __future__ import annotations

from pathlib import Path

from feeddrive.export.design import Design
from feeddrive.export.targets import edits_kept, write_all
from feeddrive.export.verify import MOST, Verified, verify_export
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineLike
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import OUT, Request, argument, option


class ExportRequest(Request):
    """The axis, or all axes, and the target."""

    source: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    target: str = option("c, linuxcnc, linuxcnc-pid, fmu2, fmu3, cortex-m, st, or parameters", short="-t")
    axis: str | None = option("its axis; default: all", default=None)
    out: Path | None = option(OUT, short="-o", default=None)
    name: str | None = option("prefix of all names; default: axis_x", default=None)
    precision: str | None = option("double or float; default: double, cortex-m float", default=None)
    plant: bool = option("c, fmu2, fmu3: the axis, to stand in for the machine", default=False)
    together: bool = option("c, cortex-m: the controls of all axes as one", default=False)
    header_only: bool = option("c: a single header", default=False)
    joint: int | None = option("linuxcnc, linuxcnc-pid: number of the joint", default=None)
    route: str | None = option("linuxcnc-pid: one or two pids", default=None)
    units: float | None = option("linuxcnc-pid: machine units in a meter, 1000 for mm", default=None)
    core: str | None = option("cortex-m: m4f, m7, or m7dp", default=None)
    maker: tuple[str, ...] = option(
        "parameters: sinumerik, twincat, odrive, linuxcnc or csv; may be repeated; default: all", default=()
    )
    lead: float | None = option("parameters: lead of the screw, if the file has none", unit="m", default=None)
    gear: float | None = option("parameters: turns of the motor in one of the screw", default=None)


@command(ExportRequest)
def export(request: ExportRequest, progress: Progress) -> Outcome[tuple[Design, ...]]:
    """Write the control of an axis as code for a target, which computes exactly what was simulated, bit for bit.

    Without an axis, the controls of all axes of the file are written; with `plant`, all axes and their couplings as one
    plant.  Without `out` the output goes to results/export_MACHINE_AXIS_TARGET.  Raises as `write_export`.
    """
    progress.step(f"export for {request.target}")
    written = write_all(
        request.source,
        request.target,
        request.out,
        axis=request.axis,
        name=request.name,
        precision=request.precision,
        plant=request.plant,
        together=request.together,
        single_header=request.header_only,
        joint=request.joint,
        route=request.route,
        units=request.units,
        core=request.core,
        makers=request.maker,
        lead=request.lead,
        gear=request.gear,
    )
    designs = tuple(design for design, _ in written)
    titles = [f"{design.title}; for the target {request.target}, every {design.period}" for design in designs]
    remarks = [
        f"Note: {f'axis {design.axis}: ' if len(designs) > 1 else ''}{remark}"
        for design in designs
        for remark in design.remarks
    ]
    remarks += [remark for _, readme in written for remark in edits_kept(readme.parent)]
    first = {f"Read first{f', axis {design.axis}' if len(designs) > 1 else ''}": readme for design, readme in written}
    judgment = next((bad for design in designs if (bad := design.judgment).bad), Judgment.EXPORTED)
    return Outcome(designs, titles, remarks, files=first, judgment=judgment)


class VerifyRequest(Request):
    """The export, the number of test samples, and the compiler."""

    directory: Path = argument("A directory that `feeddrive export` wrote")
    samples: int | None = option(
        "samples of the trial; default: 1000000, 5000 in single precision", least=1, most=MOST, default=None
    )
    seed: int = option("seed of the random samples", default=1, least=0)
    compiler: str | None = option("another compiler than gcc, cc or clang", default=None)
    flag: tuple[str, ...] = option("a flag for it, such as -O3; may be repeated", default=())
    out: Path | None = option("File for the certificate (text)", short="-o", default=None)


@command(VerifyRequest)
def verify(request: VerifyRequest, progress: Progress) -> Outcome[Verified]:
    """Repeat the equivalence test of an export with this machine's compiler."""
    progress.step(f"verifying {request.directory}")
    verified = verify_export(
        request.directory, samples=request.samples, seed=request.seed, flags=request.flag, command=request.compiler
    )
    text = verified.sentences()
    files: dict[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, text + "\n")
        files["Certificate"] = request.out
    judgment = Judgment.NOT_EQUAL if verified.differing else Judgment.EQUAL if verified.holds else Judgment.CHANGED
    return Outcome(verified, text.splitlines(), files=files, judgment=judgment)
