"""`feeddrive export` and `feeddrive verify`: write code for a target, and compare it with the simulator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from feeddrive.export.design import Design
from feeddrive.export.targets import OPTIONS, TARGETS, Target, edits_kept, write_all
from feeddrive.export.verify import MOST, Verified, verify_export
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineLike
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, line, option


def _those(has: Callable[[Target], Any]) -> str:
    """List the targets for which `has` is true, as the start of a help text."""
    return ", ".join(name for name, target in TARGETS.items() if has(target))


def _target_options() -> dict[str, tuple[str, Any]]:
    """Return the command-line options that the targets add, by the name of the request field."""
    # types without a default here are optional: None leaves the choice to the target
    defaults = {"bool": False, "tuple[str, ...]": ()}
    return {
        declared.asked or name: (
            declared.kind,
            option(
                f"{_those(lambda target, name=name: name in target.options)}: {declared.meaning}",
                unit=declared.unit,
                default=defaults.get(declared.kind),
            ),
        )
        for name, declared in OPTIONS.items()
    }


class ExportRequest(Request, more=_target_options(), after="together"):
    """The axis (default: all axes), and the target of the export."""

    source: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    target: str = option(f"{', '.join([*TARGETS][:-1])}, or {[*TARGETS][-1]}", short="-t")
    axis: str | None = option("its axis; default: all", default=None)
    out: Path | None = option(OUT, short="-o", default=None)
    name: str | None = option("prefix of all names; default: axis_x", default=None)
    precision: str | None = option("double or float; default: double, cortex-m float", default=None)
    plant: bool = option(
        f"{_those(lambda target: target.plants)}: the axis, to stand in for the machine", default=False
    )
    together: bool = option(f"{_those(lambda target: target.together)}: the controls of all axes as one", default=False)


@command(ExportRequest)
def export(request: ExportRequest, progress: Progress) -> Outcome[tuple[Design, ...]]:
    """Write the control of an axis as code for a target, with results bit-identical to those of the simulation.

    Without an axis, the controls of all axes of the file are written; with `plant`, all axes and their couplings are
    written as one plant.  Without `out` the output goes to results/export_MACHINE_AXIS_TARGET.  Raises the errors of
    `write_export`.
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
        **{name: getattr(request, declared.asked or name) for name, declared in OPTIONS.items()},
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
    # of several axes, each has its own directory to verify
    then = line("verify", written[0][1].parent) if TARGETS[request.target].proof is not None else ""
    return Outcome(designs, titles, remarks, files=first, judgment=judgment, then=then)


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
    """Repeat the proof that an export equals the simulation, with the compiler of this computer."""
    progress.step(f"verifying {request.directory}")
    verified = verify_export(
        request.directory, samples=request.samples, seed=request.seed, flags=request.flag, command=request.compiler
    )
    text = verified.sentences()
    files: dict[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, verified.record())
        files["Certificate"] = request.out
    judgment = Judgment.NOT_EQUAL if verified.differing else Judgment.EQUAL if verified.holds else Judgment.CHANGED
    return Outcome(verified, text.splitlines(), files=files, judgment=judgment)
