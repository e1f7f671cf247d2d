"""The report of a fit to frequency responses, and the plant for a machine file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from html import escape
from pathlib import Path

from feeddrive.artefacts.files.blocks_to_toml import to_toml
from feeddrive.artefacts.files.machine import Machine
from feeddrive.artefacts.files.toml_edit import TomlEdit
from feeddrive.artefacts.files.whole import new_directory
from feeddrive.artefacts.report.content import Shown
from feeddrive.artefacts.report.page import definitions, header, page, picture
from feeddrive.artefacts.report.tables import table
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.engineer.identification.modal_fit import ModalFit
from feeddrive.engineer.identification.plant_fit import PlantFit
from feeddrive.language.table import Table

_POOR = 0.35  # RMS of ln(fitted/measured) on unused lines, 3 dB, from which a model is not worth using


def write_fit(fit: PlantFit | ModalFit, machine: str | None, out: str | Path, facts: Mapping[str, str]) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; the path of the report."""
    with new_directory(out) as folder:
        if machine is not None:
            (folder / "machine.toml").write_text(machine, encoding="utf-8")
        (folder / "report.html").write_text(build(fit, facts), encoding="utf-8")
    return Path(out) / "report.html"


def build(fit: PlantFit | ModalFit, facts: Mapping[str, str]) -> str:
    """The page. Pure: the same fit gives the same text."""
    title = "Modes of a frequency response" if isinstance(fit, ModalFit) else "An axis from its frequency responses"
    drawn = Shown(
        "fit",
        "Fitted over measured",
        "Dots: the measurement. Lines: the fitted model. Below: their distance, over the size of the response.",
        "Magnitude and phase over frequency, measured and fitted, and the error between them.",
        fit.plot,
    )
    made = "".join(table(f"{each.title[:1].upper()}{each.title[1:]}.", each.heads, each.rows) for each in tables(fit))
    said = list(fit.remarks)
    if isinstance(fit, PlantFit):
        said += [f"not identifiable: {name}: {why}" for name, why in fit.not_identifiable.items()]
    items = "".join(f"<li>{escape(f'{remark[:1].upper()}{remark[1:]}.')}</li>" for remark in said)
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{items}</ul></div>' if items else ""
    links = [("result", "Result"), ("figure-fit", drawn.title), ("facts", "The measurement")]
    parts = [
        header("feeddrive identify", title, [recommendation(fit)], links),
        f'<section id="result">\n<h2>Result</h2>\n{made}{remarks}\n</section>\n',
        f'<section id="pictures">\n<h2>Pictures</h2>\n{picture(drawn)}</section>\n',
        f'<section id="facts">\n<h2>The measurement</h2>\n{definitions(facts.items())}\n</section>\n',
    ]
    return page(title, parts)


def tables(fit: PlantFit | ModalFit) -> list[Table]:
    """Parameters with errors, and how well the lines are met."""
    return [fit.table(), fit.agreement.table()]


def recommendation(fit: PlantFit | ModalFit) -> str:
    """One sentence with its reason."""
    unused = 8.686 * fit.agreement.unused
    if fit.agreement.unused > _POOR:
        where, apart = fit.agreement.worst
        return (
            f"Do not use this model: lines that were not used are missed by {unused:.2g} dB RMS, most near "
            f"{where:.4g} Hz ({apart:.2g} dB); cut the band to where the coherence is high, or ask for more modes."
        )
    if isinstance(fit, PlantFit) and fit.not_identifiable:
        return (
            f"Use this model in its band, where unused lines are predicted within {unused:.2g} dB RMS; "
            f"{', '.join(fit.not_identifiable)} cannot be told from these lines and counts as stated below."
        )
    return f"Use this model in its band: lines that were not used are predicted within {unused:.2g} dB RMS."


def machine_text(fit: PlantFit, machine: Machine | None, axis: str) -> str:
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
