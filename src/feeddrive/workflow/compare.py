"""`feeddrive compare`: all laws tuned on one axis of a machine to equal robustness."""

from __future__ import annotations

from pathlib import Path

from feeddrive.blocks.catalogue import imported
from feeddrive.blocks.families import Law
from feeddrive.comparison.compare import Comparison, compare_laws
from feeddrive.comparison.report import write_comparison
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.language.progress import Progress
from feeddrive.loop.runner import cores
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import OUT, Request, argument, option, stem


class CompareRequest(Request):
    """Which axis, which laws, and how hard each is searched for."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    axis: str | None = option("The axis, if the machine has several", default=None)
    law: tuple[str, ...] = option(
        "A law that is wanted: by name, or PACKAGE.MODULE:CLASS of your own, whose code is then run; may be repeated; "
        "default: all", default=(),
    )  # fmt: skip
    starts: int = option("Searches for each law; the best counts", default=2, least=1, most=20)
    keep: Path | None = option("Directory in which finished laws are kept, to go on after a stop", default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / f"compare_{stem(self.machine)}{'' if self.axis is None else f'_{self.axis}'}"


@command(CompareRequest)
def compare(request: CompareRequest, progress: Progress) -> Outcome[Comparison]:
    """Put all laws on one axis, tuned to equal robustness, beside today's gains, and rank them by criterion.

    Laws are tuned side by side in processes of their own.  Raises ParameterError for an axis or a law that is not
    there, UnstableError if no law can be run.
    """
    machine = read_machine(request.machine)
    laws = [imported(Law, each) if ":" in each else each for each in request.law] or None
    found = compare_laws(
        machine, request.axis, laws=laws, starts=request.starts, workers=cores(), keep=request.keep, progress=progress
    )
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("report")
        files["Report"] = write_comparison(found, request.out)
    refused = [f"'{each.name}' cannot control this axis: {each.reason}" for each in found.refusals]
    return Outcome(found, [found.table()], [f"rule: {found.rule}", *found.remarks, *refused], files=files)
