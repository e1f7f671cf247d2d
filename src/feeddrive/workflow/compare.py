"""`feeddrive compare`: compare all laws on one axis of a machine, tuned to equal robustness."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from feeddrive.blocks.catalogue import imported
from feeddrive.blocks.families import Law
from feeddrive.comparison.compare import TODAY, Comparison, advice, compare_laws, name_of
from feeddrive.comparison.report import comparison_report, write_comparison
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text, marked
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import candidates
from feeddrive.workflow.command import OUT, Outcome, argument, command, option, stem
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
    keep: Path | None = option(
        "Directory in which finished laws are kept, and taken if they are there; default: beside --out until it is "
        "written",
        default=None,
    )
    take: str | None = option("A law with whose control the machine file is written too, as taken.toml", default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"compare_{stem(self.machine)}{'' if self.axis is None else f'_{self.axis}'}"


@command(CompareRequest)
def compare(request: CompareRequest, progress: Progress) -> Outcome[Comparison]:
    """Compare all laws, tuned to equal robustness, and the present gains on one axis; rank them by criterion.

    Laws are tuned in parallel processes.  Raises ParameterError for an unknown axis or law, and for `take` without an
    output directory, and UnstableError if no law can be run.
    """
    machine = read_machine(request.machine)
    laws = [imported(Law, law) if ":" in law else law for law in request.law] or None
    take = request.take
    if take is not None:
        if request.out is None:
            raise ParameterError(f"take = '{take}' needs a directory for its machine file: out")
        take = name_of(take, machine.loop(request.axis), [law for law in laws or () if not isinstance(law, str)])
        # --take may name a law that --law does not: it is then compared too
        laws = None if laws is None else [*laws, *([] if take in laws else [take])]
    files: dict[str, Path] = {}
    with engine_of(request, request.keep, request.out) as engine:
        comparison = compare_laws(
            machine, request.axis, laws=laws, starts=request.starts, engine=engine, progress=progress
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
    return Outcome(
        comparison,
        [screen(comparison)],
        [f"rule: {comparison.rule}", *in_short(comparison)],
        verdict,
        files=files,
        details=[*comparison.remarks, *refused],
        judgment=judgment,
        page=partial(comparison_report, comparison),
    )


def names(loop: Loop, own: Sequence[type[Law]] = ()) -> list[str]:
    """Return the names of the laws that can be compared on the axis of a loop, including user-defined ones."""
    return [candidate.name for candidate in candidates(loop, own)[0]]


def taken(machine: MachineFile, axis: str, control: Control) -> str:
    """Return the text of the machine file with the control of the chosen law."""
    from feeddrive.workflow.tune_files import machine_text

    return machine_text(machine, axis, control)


# columns of the terminal table, and the keys of their figures
_COLUMNS = (
    (Column("Ms", form="2"), "sensitivity_peak"),
    (Column("delay samples", form="2"), "delay_margin_samples"),
    (Column("snap", "m √s/N", "2"), "rope_snap_ISE_root_m_per_N"),
    (Column("at 10 Hz", "N/m", "2"), "stiffness_10_Hz_N_per_m"),
    (Column("at 100 Hz", "N/m", "2"), "stiffness_100_Hz_N_per_m"),
    (Column("track RMS", "m", "2"), "tracking_error_rms_m"),
    (Column("settled", "s", "2"), "snap_settling_s"),
    (Column("noise", "N", "2"), "force_noise_N"),
)
# a full stop between sentences: not a decimal point, nor a dot between the names of code
_SENTENCES = re.compile(r"\. (?=[A-Z])")


def screen(comparison: Comparison) -> Table:
    """Tabulate robustness and the main figures of merit to two digits; laws without a rank are marked."""
    rows = [
        [
            f"{competitor.name}{' *' if competitor.unplaced or competitor.unfit else ''}",
            *(competitor.figures.get(key) for _, key in _COLUMNS),
        ]
        for competitor in comparison.competitors
    ]
    return Table(f"{comparison.title}; * not ranked", [Column("law"), *(column for column, _ in _COLUMNS)], rows)


def in_short(comparison: Comparison) -> list[str]:
    """Return sentences about laws without a rank, a complete proof or tunable parameters, and about refused laws."""
    tuned = [competitor for competitor in comparison.competitors if competitor.tuned is not None]
    groups = {
        "Nothing to tune, so judged as it is": [
            competitor for competitor in comparison.competitors if competitor.tuned is None and competitor.name != TODAY
        ],
        "Not settled, so not ranked (more --starts may find better gains)": [
            competitor for competitor in tuned if not competitor.settled
        ],
        "Outside of the rule, so not ranked": [
            competitor for competitor in comparison.competitors if competitor.outside and competitor.settled
        ],
        "Without figures, unstable or out of bounds": [
            competitor for competitor in comparison.competitors if competitor.unfit
        ],
        "Not proven in every point": [
            competitor
            for competitor in tuned
            if competitor.tuned is not None and any(line.holds is not True for line in competitor.tuned.proof)
        ],
    }
    lines = [
        f"{head}: {', '.join(competitor.name for competitor in group)}." for head, group in groups.items() if group
    ]
    refused = dict[str, list[str]]()
    for refusal in comparison.refusals:
        first = _SENTENCES.split(marked(refusal.reason), maxsplit=1)[0].rstrip(".")
        # many laws are refused for the same first reason: one line with all names instead of one for each
        refused.setdefault(first, []).append(refusal.name)
    return [
        *lines,
        *(Text(f"Cannot control this axis: {', '.join(names)}: {reason}.") for reason, names in refused.items()),
    ]
