"""`feeddrive compare`: compare all laws on one axis of a machine, tuned to equal robustness."""

from __future__ import annotations

import re
import shlex
from functools import partial
from pathlib import Path

from feeddrive.blocks.catalogue import imported
from feeddrive.blocks.families import Law
from feeddrive.comparison.compare import (
    TODAY,
    Comparison,
    advice,
    against_plain,
    best_law,
    compare_laws,
    noisy,
    standings,
)
from feeddrive.comparison.report import comparison_report, write_comparison
from feeddrive.evaluation.lineup import Lineup
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.text import Text, marked
from feeddrive.loop.box import AUTO, Box
from feeddrive.loop.control import Control
from feeddrive.workflow.command import (
    AT_THE_MODEL,
    BOX,
    OF_ERRORS,
    OUT,
    Outcome,
    argument,
    command,
    exporting,
    option,
    stem,
)
from feeddrive.workflow.evaluated import EvaluationRequest, engine_of

TAKEN = "taken.toml"


class CompareRequest(EvaluationRequest):
    """The axis, the laws to compare, and the number of searches per law."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    axis: str | None = option("The axis, if the machine has several", default=None)
    law: tuple[str, ...] = option(
        "A law that is wanted: by name, by kind, as cascade_ppi, or PACKAGE.MODULE:CLASS of your own, whose code is "
        "then run; may be repeated; default: all",
        default=(),
    )
    starts: int = option("Searches for each law; the best counts", default=2, least=1, most=20)
    box: str = option(BOX, default=AUTO)
    filters: str | None = option(
        "filters of all laws: kept, or free (tuned with every law, with a notch and a low-pass); default: free with a "
        "box, kept without",
        default=None,
    )
    seed: int = option("Seed of the searches and of the noise of the encoders", default=0, least=0)
    keep: Path | None = option(
        "Directory in which finished laws are kept, and taken if they are there; default: beside --out until it is "
        "written",
        default=None,
    )
    take: str | None = option("A law with whose control the machine file is written too, as taken.toml", default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for a box that cannot be read."""
        Box.parse(self.box)

    def usual_out(self) -> Path:
        return Path("results") / f"compare_{stem(self.machine)}{'' if self.axis is None else f'_{self.axis}'}"


@command(CompareRequest)
def compare(request: CompareRequest, progress: Progress) -> Outcome[Comparison]:
    """Compare all laws, tuned to equal robustness, with the existing gains of an axis, and rank them by each criterion.

    Laws are tuned in parallel processes.  Raises ParameterError for an unknown axis or law and for `take` without an
    output directory, and UnstableError if no law can be run.
    """
    machine = read_machine(request.machine)
    laws = [imported(Law, law) if ":" in law else law for law in request.law] or None
    take = request.take
    if take is not None:
        if request.out is None:
            raise ParameterError(f"take = '{take}' needs a directory for its machine file: out")
        own = [law for law in laws or () if not isinstance(law, str)]
        take = Lineup.of(machine.loop(request.axis), own).fitting(take)
        # --take may name a law that --law does not: it is then compared too
        laws = None if laws is None else [*laws, *([] if take in laws else [take])]
    files: dict[str, Path] = {}
    box = machine.box(request.box, request.axis)
    with engine_of(request, request.keep, request.out) as engine:
        comparison = compare_laws(
            machine,
            request.axis,
            laws=laws,
            box=box,
            filters=request.filters,
            seed=request.seed,
            starts=request.starts,
            engine=engine,
            progress=progress,
        )
        if request.out is not None:
            progress.step("report")
            if take is None:
                files["Report"] = write_comparison(comparison, request.out)
            else:
                text = taken(comparison.machine, comparison.axis, comparison[take].loop.control)
                files["Report"] = write_comparison(comparison, request.out, {TAKEN: text})
                files["Machine"] = request.out / TAKEN
    refused = [f"'{refusal.name}' cannot control this axis: {refusal.reason}" for refusal in comparison.refusals]
    judgment, verdict = advice(comparison)
    then, notes = _next(request, comparison, take, files.get("Machine"))
    if box is None:
        notes = (*notes, AT_THE_MODEL)
    elif box.deviations:
        notes = (*notes, OF_ERRORS)
    return Outcome(
        comparison,
        [comparison.table()],
        [f"rule: {comparison.rule}", *in_short(comparison)],
        verdict,
        notes,
        files=files,
        details=[*against_plain(comparison), *noisy(comparison), *refused],
        judgment=judgment,
        page=partial(comparison_report, comparison),
        then=then,
    )


def _next(
    request: CompareRequest, comparison: Comparison, take: str | None, machine: Path | None
) -> tuple[str, tuple[str, ...]]:
    """Return the suggested next command and notes: towards an export of the chosen law, or to choose the best law."""
    if machine is not None and take is not None:
        guarded = comparison[take].loop.control.guard is not None
        return exporting(machine, request.axis, guarded=guarded)
    best = best_law(comparison)
    return "" if best in ("", TODAY) else f"{request.command_line('compare')} {shlex.join(('--take', best))}", ()


def taken(machine: MachineFile, axis: str, control: Control) -> str:
    """Return the text of the machine file with the control of the chosen law."""
    from feeddrive.workflow.tune_files import machine_text

    return with_origins(machine_text(machine, axis, control), (machine,))


_SENTENCES = re.compile(r"\. (?=[A-Z])")  # between sentences, not a decimal point in code


def in_short(comparison: Comparison) -> list[str]:
    """Return the sentences of `standings`, then those on laws that cannot control the axis, one for each reason."""
    refused = dict[str, list[str]]()
    for refusal in comparison.refusals:
        first = _SENTENCES.split(marked(refusal.reason), maxsplit=1)[0].rstrip(".")
        # many laws are refused for the same first reason: one line with all names instead of one for each
        refused.setdefault(first, []).append(refusal.name)
    return [
        *standings(comparison),
        *(Text(f"Cannot control this axis: {', '.join(names)}: {reason}.") for reason, names in refused.items()),
    ]
