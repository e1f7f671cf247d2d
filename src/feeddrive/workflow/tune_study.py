"""`feeddrive tune --study`: one controller for all machines of a study, proven on newly drawn machines.

report.html    the result, the spread of figures over newly drawn machines, the machines that limit the tuning
summary.json   the same figures as numbers
machine.toml   the study's machine file with the new control, if it is valid and better
control.toml   the new control alone
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive.figures.of_loops import ROPE_SNAP
from feeddrive.files.origins import with_origins
from feeddrive.files.run_files import summary_text
from feeddrive.files.section import to_toml
from feeddrive.language.errors import FeeddriveError, UnstableError, sentence
from feeddrive.language.judgment import Judgment
from feeddrive.language.table import Cell, Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.report.page import write_page
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.study.robust import Measured, Robust, RobustTuner, bound_sentence, in_percent, is_limit
from feeddrive.tuning.candidates import candidates, control_with
from feeddrive.tuning.tune import law_tunables
from feeddrive.workflow.command import Outcome
from feeddrive.workflow.control_text import machine_text
from feeddrive.workflow.tune_files import Story, summary, tables

EVERY = "every"  # in place of a law name: all laws that can control the axis


@dataclass(frozen=True, eq=False)
class Laws:
    """The laws tuned on the same machines by name, best first, and the reasons why others were refused.

    The best law meets the specification on the largest number of newly drawn machines; ties go to the smaller 95 %
    quantile of the rope-snap error.
    """

    tuned: Mapping[str, Robust]
    refused: Mapping[str, str]

    @property
    def best(self) -> Robust:
        """The result of the best law."""
        return next(iter(self.tuned.values()))

    def table(self) -> Table:
        """Tabulate the laws, with the existing control in the last row."""
        rows = [
            [name, *_cells(robust.after), "no" if robust.unsettled else "yes"] for name, robust in self.tuned.items()
        ]
        columns = [
            Column("law"),
            Column("yield and its 95 % interval"),
            Column("median snap", "m √s/N"),
            Column("95 % quantile", "m √s/N"),
            Column("settled"),
        ]
        title = f"{self.best.after.count} fresh machines under each law"
        return Table(title, columns, [*rows, ["today", *_cells(self.best.before), None]])


def _cells(fresh: Measured) -> list[Cell]:
    return [in_percent(fresh.all), fresh.quantile(ROPE_SNAP.key, 0.5), fresh.quantile(ROPE_SNAP.key, 0.95)]


def tune_laws(tuner: RobustTuner, law: str | None) -> Laws:
    """Tune one law (default: the existing one), or, with `every`, all laws of the catalog that can control the axis.

    Raises UnstableError if none of them satisfies the limits.
    """
    refused: dict[str, str] = {}
    starts: dict[str, Control] = {}
    today = tuner.loop.control
    if law == EVERY:
        usable, unusable = candidates(tuner.loop)
        refused |= {candidate.name: candidate.reason for candidate in unusable if " + " not in candidate.name}
        starts |= {candidate.name: candidate.loop.control for candidate in usable if " + " not in candidate.name}
        # a law without tunable parameters would be tuned to what it is
        starts = {name: control for name, control in starts.items() if law_tunables(control)}
    else:
        kind = today.law.kind if law is None else law
        starts[kind] = today if kind == today.law.kind else control_with(tuner.loop, kind)
    tuned: dict[str, Robust] = {}
    for name, control in starts.items():
        try:
            tuned[name] = tuner.tuned(control)
        except FeeddriveError as error:
            if law != EVERY:
                raise
            # one law without a result must not end a search over all of them
            refused[name] = str(error)
    if not tuned:
        raise UnstableError(f"no law keeps {tuner.limits.sentence()} on the machines of the study: {_first(refused)}")
    best = sorted(
        tuned, key=lambda name: (-tuned[name].after.all.kept, tuned[name].after.quantile(ROPE_SNAP.key, 0.95))
    )
    return Laws({name: tuned[name] for name in best}, refused)


def _first(refused: Mapping[str, str]) -> str:
    return joined("; ", (f"{name}: {reason}" for name, reason in list(refused.items())[:3]))


def tuned_study(tuner: RobustTuner, law: str | None, out: Path | None, again: Mapping[str, str]) -> Outcome[Any]:
    """Tune for a study and return the outcome of the command; `again` states how to repeat it."""
    laws = tune_laws(tuner, law)
    best = laws.best
    text = _machine(best)
    page = partial(robust_report, best, laws, again)
    files: dict[str, Path] = {}
    if out is not None:
        tuner.progress.step("report")
        report = _write(laws, page(), text, out)
        files = {"Machine": report.parent / "machine.toml"} if text is not None else {}
        files["Report"] = report
    shown = [best.table(), _values(best)]
    if len(laws.tuned) > 1:
        shown.insert(0, laws.table())
    judgment = Judgment.TAKE_TUNING if best.better else Judgment.FEWER_ARE_GOOD
    judgment = judgment if best.tuned.holds else Judgment.DO_NOT_USE_TUNING
    proof = [Text(f"proof, {line.what}: {line.text}") for line in best.tuned.proof]
    return Outcome(
        best,
        shown,
        _remarks(laws),
        best.sentence(),
        files=files,
        details=proof,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        rotary=best.rotary,
        page=page,
    )


def _machine(best: Robust) -> str | None:
    """Return the text of the machine file with the new control; None if that control is invalid or not better."""
    # the bases differ in the choices of the study only: the first one stands for the machine file
    base = next(best.study.bases())
    if not best.tuned.holds or not best.better:
        return None
    return with_origins(machine_text(base.job.machine, base.axis, best.tuned.control), (base.job.machine,))


def _remarks(laws: Laws) -> list[str]:
    """Return remarks on the tuning result."""
    best = laws.best
    remarks: list[str] = [Text(f"held back by {held.sentence()}") for held in best.tuned.held]
    remarks += [
        Text(f"proof, {line.what}: does not hold ({line.text})") for line in best.tuned.proof if line.holds is False
    ]
    remarks += [Text(f"not settled: {best.unsettled}")] if best.unsettled else []
    beside = [bound_sentence(bound) for bound in best.after.bounds if not is_limit(bound)]
    if beside:
        remarks.append(Text(f"counted in the yield, but not kept by the tuner: {joined(', ', beside)}"))
    remarks += [Text(f"variant {number} was left out: {reason}") for number, reason in best.bad[:5]]
    remarks += [f"{len(best.bad) - 5} more were left out"] if len(best.bad) > 5 else []
    if len(best.study.jobs) > 1:
        remarks.append("the machine file is that of the first choice of the study; control.toml is for all")
    remarks += [Text(f"'{name}' was not tuned: {reason}") for name, reason in laws.refused.items()]
    return remarks


def _values(best: Robust) -> Table:
    """Tabulate the parameters of the control, old and new."""
    return tables(best.tuned, Story(best.study.title, {}))[0]


def _write(laws: Laws, page: Report, text: str | None, out: Path) -> Path:
    """Write all files into a directory; return the path of the report."""
    best = laws.best
    base = next(best.study.bases())
    numbers = {
        "sentence": best.sentence(),
        "yield": {"today": _share(best.before), "new": _share(best.after)},
        "bounds": {
            bound_sentence(bound): {"today": best.before.keeping(bound).value, "new": best.after.keeping(bound).value}
            for bound in best.after.bounds
        },
        "machines": {"sampled": best.seen.goal.size, "share": best.share, "decide": list(best.active)},
        "laws": {name: _share(robust.after) for name, robust in laws.tuned.items()},
        "not_tuned": dict(laws.refused),
        "tuning": summary(best.tuned, (), ()),
    }
    texts = {
        "summary.json": summary_text(numbers, rotary=best.rotary),
        "control.toml": to_toml(best.tuned.control, f"axis.{base.axis}.control", rotary=best.rotary),
    }
    machine = {} if text is None else {"machine.toml": text}
    return write_page(out, page, texts | machine)


def _share(fresh: Measured) -> dict[str, Any]:
    return {"value": fresh.all.value, "interval_95_percent": list(fresh.all.interval or ()), "machines": fresh.count}


def robust_report(best: Robust, laws: Laws | None = None, known: Mapping[str, str] | None = None) -> Report:
    """Return the report of one controller for the machines of a study.

    laws   all laws tuned on these machines, the best of which is reported; None: only one law was tuned
    known  facts about the command
    """
    laws = laws or Laws({best.tuned.control.law.kind: best}, {})
    values, *_, proof = tables(best.tuned, Story(best.study.title, {}))
    result_tables = [*([laws.table()] if len(laws.tuned) > 1 else []), best.table(), values]
    first, second = (
        Picture(
            "fresh",
            "Fresh machines",
            f"By figure the share of {best.after.count} machines, which the tuner never saw, that lie below a value. "
            "Shaded: outside of the bounds.",
            "Distribution of figures over the fresh machines, today and new.",
            best.chart,
        ),
        Picture(
            "deciding",
            "The machines that decide",
            "Dynamic stiffness of those sampled machines that limit the tuning, under both controls.",
            "Frequency responses of the machines that decide.",
            best.tuned.chart,
        ),
    )
    stated = {
        **(known or {}),
        "Rule": best.tuned.rule,
        "Machines of the tuner": f"{best.seen.goal.size}, drawn by {best.study.sampler}, seed {best.study.seed}",
        "Fresh machines": f"{best.after.count}, Monte Carlo, stream 1 of the same seed",
        "Rounds": "; ".join(f"{machines} machines, {kept} keep all limits" for machines, kept in best.rounds),
    }
    return Report(
        f"{best.study.title}: one control for all machines",
        "feeddrive tune --study",
        Verdict((best.sentence(),), good=best.tuned.holds and best.better),
        (
            Section("result", "Result", (*result_tables, Remarks(map(sentence, _remarks(laws))))),
            further((second,)),
            Section("proof", "Proof on the machines that decide", (_deciding(best), proof), folded=True),
            facts("How", stated),
        ),
        first,
        best.rotary,
    )


def _deciding(best: Robust) -> Table:
    """Tabulate the figures, under the new control, of the machines that limit the tuning."""
    rows = [
        [
            figures.point,
            figures.margins.sensitivity_peak,
            figures.margins.phase_margin_deg,
            figures.stiffness.minimum,
            figures.rope_snap,
        ]
        for figures in best.tuned.after
    ]
    columns = [
        Column("machine"),
        Column("Ms", form=".3f"),
        Column("phase margin", "deg", ".1f"),
        Column("least stiffness", "N/m"),
        Column("rope-snap error", "m √s/N"),
    ]
    return Table("the machines that decide, under the new control", columns, rows)
