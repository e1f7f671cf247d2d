"""The page of a commissioning, finished or not: the trial, the steps, the figures, the responses and the files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from feeddrive.commissioning.record import FILE, Commissioned
from feeddrive.language.judgment import Judgment
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.plot import commissioning as plot
from feeddrive.report.report import Facts, Marked, Picture, Remarks, Report, Section, Verdict


def commission_report(commissioned: Commissioned, folder: Path | None = None) -> Report:
    """Return the report of a commissioning; `folder`: where its files are, if they were kept."""
    first, *others = [*_pictures(commissioned), None]
    steps = [[step.name.replace("_", " "), step.says] for step in commissioned.steps]
    return Report(
        "Commissioning of a drive",
        "feeddrive commission",
        Verdict((verdict(commissioned),), good=_good(commissioned)),
        (
            Section("figures", "Predicted, measured, before", _figures(commissioned)),
            Section("steps", "Steps", (Marked(Table("", ["step", "result"], steps), text=True),) if steps else ()),
            Section("pictures", "What was measured", tuple(picture for picture in others if picture is not None)),
            Section("files", "Files", () if folder is None else (Facts(_files(commissioned, folder)),)),
        ),
        first,
        rotary=commissioned.rotary,
    )


def verdict(commissioned: Commissioned) -> str:
    """Return the sentence that says how a commissioning ended, or which step was the last of one that goes on."""
    trial = commissioned.trial
    if commissioned.kept:
        assert trial is not None
        told = Text(
            f"{Judgment.COMMISSIONED.says}: following error {Quantity(trial.measured.following_rms, 'm'):3} RMS, "
            f"stiffness {Quantity(trial.measured.stiffness, 'N/m'):3}"
        )
        if trial.before is None:
            return told
        before = trial.before
        return Text(f"{told}; before {Quantity(before.following_rms, 'm'):3} and {Quantity(before.stiffness, 'N/m'):3}")
    if commissioned.refusal:
        return Text(f"{Judgment.NOT_COMMISSIONED.says}: {commissioned.refusal}")
    if not commissioned.steps:
        return "Nothing was done yet."
    return Text(f"Not finished: the last step was {commissioned.steps[-1].name.replace('_', ' ')}.")


def _good(commissioned: Commissioned) -> bool | None:
    return True if commissioned.kept else False if commissioned.refusal else None


def _figures(commissioned: Commissioned) -> tuple[Table | Remarks, ...]:
    trial = commissioned.trial
    if trial is None:
        return ()
    remarks = ["Both are found from the logs by the same function; that of the prediction is simulated."]
    if trial.before is None:
        remarks.append("The control before was not measured: it could not run this motion within the limits.")
    return trial.table(), Remarks(remarks, "How they are found", warns=False)


def _pictures(commissioned: Commissioned) -> Iterator[Picture]:
    found = commissioned.evidence
    if "alone" in found.runs and "pushed" in found.runs:
        yield Picture(
            "trial",
            "Trial of the new control",
            "What the drive did, and what was predicted before. Deflection: the reading with a pulse of force less "
            "that without it; the force is that with the pulse.",
            "Following error, deflection by a pulse of force, force and velocity over time, predicted and measured.",
            lambda: plot.commissioning_trial_chart(found.runs),
        )
    if found.responses:
        yield Picture(
            "responses",
            "Responses, model over measured",
            "Dots: measured, in the band of 95 % where the variance is known. Lines: the model. Error: their distance.",
            "Magnitude and phase of the readings over the commanded force, with error and coherence.",
            lambda: plot.commissioning_responses_chart(found.responses),
        )
    strokes = found.strokes
    if strokes is not None:
        yield Picture(
            "strokes",
            "Strokes under the start law",
            "Mass, friction and dead time are identified from these.",
            "Set position, following error and force of the strokes over time.",
            lambda: plot.strokes_chart(strokes),
        )


def _files(commissioned: Commissioned, folder: Path) -> Iterator[tuple[str, str]]:
    yield "Record", str(folder / FILE)
    for step in commissioned.steps:
        places = {name.partition("/")[0] for name in step.files}
        if places:
            yield step.name.replace("_", " ").capitalize(), str(folder / min(places))
