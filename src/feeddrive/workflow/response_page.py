"""The report of a fit to frequency responses, and the plant for a machine file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

from feeddrive import plot
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.machine import MachineFile
from feeddrive.files.messages import sentence
from feeddrive.files.toml_edit import TomlEdit
from feeddrive.identification.response.fit_axis import AxisFits
from feeddrive.identification.response.modal_fit import ModalFit
from feeddrive.identification.response.plant_fit import PlantFit
from feeddrive.language import tree
from feeddrive.language.table import Table
from feeddrive.report.content import Shown
from feeddrive.report.page import definitions, header, page, picture, table

_POOR = 0.35  # RMS of ln(fitted/measured) on unused lines, 3 dB, from which a model is not worth using
_DECIBEL = 8.686  # of 1 in ln


def write_fit(
    found: AxisFits | ModalFit, remarks: Sequence[str], machine: str | None, out: str | Path, facts: Mapping[str, str]
) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; the path of the report."""
    with new_directory(out) as folder:
        if machine is not None:
            (folder / "machine.toml").write_text(machine, encoding="utf-8")
        (folder / "report.html").write_text(build(found, remarks, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(found: AxisFits | ModalFit, remarks: Sequence[str], facts: Mapping[str, str]) -> str:
    """The page. Pure: the same fit gives the same text."""
    modal = isinstance(found, ModalFit)
    title = "Modes of a frequency response" if modal else "An axis from its frequency responses"
    fit = found if isinstance(found, ModalFit) else found.fit
    drawn = list(_pictures(fit))
    made = "".join(table(sentence(each.title), each.heads, each.rows) for each in tables(found))
    said = list(remarks)
    if isinstance(fit, PlantFit):
        said += [f"not identifiable: {name}: {why}" for name, why in fit.not_identifiable.items()]
    items = "".join(f"<li>{escape(sentence(remark))}</li>" for remark in said)
    listed = f'<div class="remarks"><h3>Remarks</h3><ul>{items}</ul></div>' if items else ""
    links = [("result", "Result"), *((f"figure-{each.key}", each.title) for each in drawn), ("facts", "Measurement")]
    parts = [
        header("feeddrive identify", title, [recommendation(found)], links),
        f'<section id="result">\n<h2>Result</h2>\n{made}{listed}\n</section>\n',
        f'<section id="pictures">\n<h2>Pictures</h2>\n{"".join(picture(each) for each in drawn)}</section>\n',
        f'<section id="facts">\n<h2>The measurement</h2>\n{definitions(facts.items())}\n</section>\n',
    ]
    return page(title, parts)


def _pictures(fit: PlantFit | ModalFit) -> Iterator[Shown]:
    found = fit.agreement
    coherent = any(frf.coherence is not None for frf in found.measured)
    yield Shown(
        "fit",
        "Fitted over measured",
        "Dots: the measurement, in its 95 % band where the variance is known. Lines: the fitted model. Error: their "
        "distance over the size of the response; the dashed line is what noise explains on each line."
        + (" Coherence: 1 is a response without noise." if coherent else ""),
        "Magnitude and phase over frequency, measured and fitted, the error between them, and the coherence.",
        found.plot,
    )
    yield Shown(
        "residual",
        "Residuals",
        "Noise would scatter without order, and its autocorrelation would stay between the dashed lines. Waves over "
        "several lines are something regular that is not in the model.",
        f"Weighted residuals over frequency; autocorrelation {found.autocorrelation():.2f} from line to line.",
        lambda: plot.response_residuals(found),
    )
    yield Shown(
        "nyquist",
        "In the complex plane",
        "As velocity over force, where each resonance is a circle: its diameter is one over its damping.",
        "Measured and fitted responses in the complex plane.",
        lambda: plot.response_nyquist(found),
    )


def tables(found: AxisFits | ModalFit) -> list[Table]:
    """Structures that were compared, parameters with errors, and how well the lines are met."""
    if isinstance(found, ModalFit):
        return [found.table(), found.agreement.table()]
    compared = [found.table()] if len(found.fits) + len(found.refused) > 1 else []
    return [*compared, found.fit.table(), found.fit.agreement.table()]


def told_by(fit: PlantFit | ModalFit) -> str:
    """Why the fit must not become part of a machine file; empty if it may."""
    if isinstance(fit, ModalFit):
        return "modes without masses are no plant; --model modal makes one"
    if fit.agreement.unused > _POOR:
        return f"the model misses lines that were not used by {_DECIBEL * fit.agreement.unused:.2g} dB"
    if not fit.units.si:
        return f"the result is in {fit.units.of('kg')}; give --force-constant and --lead"
    kinds = {name: name.rsplit(".", 1)[-1].split("_")[0] for name, _ in tree.leaves(fit.plant)}
    open_ = [name for name in fit.not_identifiable if kinds.get(name) in ("mass", "stiffness", "frequency", "coupling")]
    damped = [name for name in open_ if not name.endswith("damping")]
    if damped and fit.plant.kind in ("two_mass", "modal"):
        return f"{', '.join(damped)} cannot be told from these lines; what to measure next stands above"
    return ""


def recommendation(found: AxisFits | ModalFit) -> str:
    """One sentence with its reason."""
    fit = found if isinstance(found, ModalFit) else found.fit
    unused = _DECIBEL * fit.agreement.unused
    if fit.agreement.unused > _POOR:
        where, apart = fit.agreement.worst
        wrong = not isinstance(found, ModalFit) and found.wrong_sign
        other = (
            "the motor's encoder does not sit where the force acts: give a machine file with the structure of the axis "
            "(a chain of three masses has its encoder on the screw), or take --model modes"
            if wrong
            else "cut the band to where the coherence is high, or ask for more modes"
        )
        return (
            f"Do not use this model: lines that were not used are missed by {unused:.2g} dB RMS, most near "
            f"{where:.4g} Hz ({apart:.2g} dB); {other}."
        )
    if told_by(fit) and isinstance(fit, PlantFit) and fit.units.si:
        return f"Measure once more before you use this model: {told_by(fit)}."
    which = "" if isinstance(found, ModalFit) or len(found.fits) < 2 else f" ({found.chosen})"
    if isinstance(fit, PlantFit) and fit.not_identifiable:
        return (
            f"Use this model{which} in its band, where unused lines are predicted within {unused:.2g} dB RMS; "
            f"{', '.join(fit.not_identifiable)} cannot be told from these lines and counts as stated."
        )
    return f"Use this model{which} in its band: lines that were not used are predicted within {unused:.2g} dB RMS."


def machine_text(fit: PlantFit, machine: MachineFile | None, axis: str) -> str:
    """A machine file with the fitted plant and dead time, comments kept; without one, the two sections alone."""
    plant, actuator = fit.blocks()
    section, place = to_toml(plant, f"axis.{axis}.plant"), ("axis", axis, "plant")
    if machine is None:
        head = "# plant and actuator of an axis, from frequency responses; add control, limits and encoders\n\n"
        edit = TomlEdit(f"{head}{section}\n{to_toml(actuator, f'axis.{axis}.actuator')}", "identified.toml")
    else:
        edit = TomlEdit(machine.file.text, machine.file.name)
        before = machine.loop(axis).axis
        if type(before.plant) is type(plant) and fit.plant.kind == "two_mass":
            for each in fit.estimates:
                if hasattr(plant, each.name):
                    edit.set((*place, each.name), each.value, each.unit)
        else:
            edit.replace(place, section)
        if "current_loop" in fit.not_identifiable and actuator.current_loop is None:
            before = replace(before, actuator=replace(before.actuator, current_loop=None))
            edit.silence(("axis", axis, "actuator", "current_loop"), "Hz")
        _actuator(edit, axis, before.actuator, actuator)
    for each in fit.estimates:
        parts = [int(part) if part.isdigit() else part for part in each.name.split(".")]
        at_drive = each.name in ("dead_time", "current_loop")
        key = ("axis", axis, "actuator", each.name) if at_drive else (*place, *parts)
        if edit.has(key[:-1]):
            value = getattr(actuator, each.name) if len(parts) == 1 and hasattr(actuator, each.name) else each.value
            edit.comment(edit.set(key, float(value), each.unit), f"standard error {each.error:.2g} {each.unit}".strip())
    return edit.text


def _actuator(edit: TomlEdit, axis: str, before: Actuator, after: Actuator) -> None:
    """Dead time and current loop where they changed; the motor stays."""
    kept = replace(after, motor=before.motor, current_loop=after.current_loop or before.current_loop)
    key = ("axis", axis, "actuator")
    if not edit.has(key):
        edit.add(to_toml(kept, f"axis.{axis}.actuator"))
        return
    edit.set((*key, "dead_time"), float(kept.dead_time), "s")
    if kept.current_loop is not None:
        edit.set((*key, "current_loop"), float(kept.current_loop), "Hz")
