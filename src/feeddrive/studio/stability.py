"""The proof of stability as the page shows it: proven or not and by how much, what it covers, and its pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from feeddrive import plot
from feeddrive.certificate.certificate import Certificate
from feeddrive.certificate.certify import certify_loop
from feeddrive.files.atomic_io import written_whole
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import NotCertifiedError, sentence
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import DRAWN, Quantity, Units
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.plot.chart import Chart
from feeddrive.studio.jobs import perform
from feeddrive.studio.works import Shown, shown
from feeddrive.workflow.certify import FILE, CertifyRequest

REPORT = "certificate_report.html"
_EXAMPLE = "ball_screw"
# what the standard text of a certificate says of its limits, each in a line; `details` of the page holds that text
_OUTSIDE = (
    "Force and current at their limits, anti-windup at work",
    "Stiction, reversal, backlash (friction: at {velocity})",
    "Counts of the encoders and limit cycles",
    "Wear, temperature, positions and loads not listed",
)
_ROUNDED = 0.999  # of what could be proven: a proof needs some room, however little


def proven(request: CertifyRequest, controls: Mapping[str, Loop], progress: Progress) -> Shown:
    """Prove a loop stable, or state what stands in the way; `proof` of the words is what the page shows first.

    controls  the same loop under other controls, of which the room is shown, too
    """
    try:
        outcome = perform("certify", request, progress)
    except NotCertifiedError as error:
        # a loop that is not proven is a result, with a frequency and a way on
        draft = error.draft if isinstance(error.draft, Certificate) else None
        page = Shown({"verdict": [], "failure": "", "bad": True, "said": [], "picture": None, "sections": []})
        reason, rotary = str(error), _any(controls).axis.rotary
    else:
        draft, page, reason, rotary = outcome.result, shown(outcome, ()), "", outcome.rotary
    units = replace(DRAWN, rotary=rotary)
    words = _stated(draft, reason, request, _any(controls), units)
    words["rooms"] = [{"name": name, "room": _room(loop, request)} for name, loop in controls.items()]
    words["files"] = [] if reason else _files(request)
    charts = {} if draft is None else _charts(draft, units)
    return replace(page, words={**page.words, "proof": words}, charts={**page.charts, **charts})


@cache
def example() -> tuple[str, Mapping[str, Chart]]:
    """Return the name of the bundled axis that the page proves as an example, and its picture."""
    machine = read_machine(_EXAMPLE)
    name = next(iter(machine.loops))
    return machine.name, {"margin": certify_loop(machine.loop(name)).chart().shown(DRAWN)}


def _any(controls: Mapping[str, Loop]) -> Loop:
    return next(iter(controls.values()))


def _stated(
    draft: Certificate | None, reason: str, request: CertifyRequest, loop: Loop, units: Units
) -> dict[str, Any]:
    """Return the verdict, its distance, and what it covers and does not cover.

    draft   the certificate, or what was tried; None if the loop itself is unstable
    reason  why it is not proven; empty if it is
    """
    told = partial(Text.shown, units=units)
    velocity = told(Text(f"{Quantity(request.velocity, 'm/s'):3}"))
    nyquist = 0.5 / float(loop.sample_time)
    fastest = f"{0.001 * nyquist:.3g} kHz" if nyquist >= 1000.0 else f"{nyquist:.3g} Hz"
    encoders = "both encoders" if loop.axis.encoders() > 1 else "the encoder"
    words: dict[str, Any] = {
        "proven": not reason,
        "head": "This loop stays stable.",
        "sentence": "",
        "room": None,
        "tightest": "",
        "frequency": None,
        "instead": None,
        "outside": [line.format(velocity=velocity) for line in _OUTSIDE],
    }
    covers = [
        f"The gains as stored, rounded to {request.arithmetic}",
        f"Dead time, filters and {encoders}",
        f"Every frequency from 0 to {fastest}",
    ]
    if draft is None:
        _, _, cause = reason.partition("': ")
        words |= {"head": "The loop itself is unstable.", "sentence": sentence(told(Text(cause or reason)))}
        words["covers"] = [*((line, True) for line in covers), ("The model without any error", False)]
        return words
    plants = draft.document["plants"]
    radii = [r for plant in plants for band in plant["radius"] for r in band["r"]]
    wrong = _percent(max(radii)) if len({*radii}) == 1 else f"{_percent(min(radii))} to {_percent(max(radii))}"
    words["covers"] = [
        *((line, True) for line in covers),
        (f"Up to {wrong} error in gain and phase", not reason),
    ]
    tight = min(plants, key=lambda plant: plant["reserve"] or math.inf)
    place = "" if len(plants) == 1 else f", {tight['name']}"
    words["room"] = draft.reserve
    words["frequency"] = tight["reserve_at_Hz"]
    at = told(Text(f"{Quantity(tight['reserve_at_Hz'], 'Hz'):3}"))
    words["tightest"] = f"Tightest at {at}{place}"
    if not reason:
        words["sentence"] = (
            f"For every axis whose response is within {wrong} of the model, at every frequency up to {fastest} and "
            "not just for the one that is drawn."
        )
        return words
    if draft.reserve is None or draft.reserve > 1.0:
        words |= {"head": "The checker refused it.", "sentence": sentence(told(Text(reason)))}
        return words
    least = min(r for band in tight["radius"] for r in band["r"])
    instead = _less(_ROUNDED * least * draft.reserve)
    words |= {
        "head": "Too little room.",
        "sentence": (
            f"An axis that differs from the model by {_percent(least * draft.reserve)} at {at} can reach instability; "
            f"{_percent(least)} was asked for. Up to {_percent(instead)} can be proven."
        ),
        "instead": 100.0 * instead,
    }
    return words


def _less(share: float) -> float:
    """Return a share rounded down to two digits."""
    step = 10.0 ** (math.floor(math.log10(share)) - 1)
    return round(math.floor(share / step) * step, 12)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _charts(certificate: Certificate, units: Units) -> dict[str, Chart]:
    """Return the pictures: the room at each frequency and, for one rate of samples, where L may lie."""
    charts = {"margin": certificate.chart()}
    if not certificate.two_rates:
        charts["discs"] = plot.certificate_discs_chart(certificate)
    return {name: chart.shown(units) for name, chart in charts.items()}


def _room(loop: Loop, request: CertifyRequest) -> float | None:
    """Return how many times the needed room a loop has; None without a limit, 0 if it is unstable."""
    try:
        return certify_loop(
            loop, radius=request.radius, arithmetic=request.arithmetic, velocity=request.velocity
        ).reserve
    except NotCertifiedError as error:
        return error.draft.reserve if isinstance(error.draft, Certificate) else 0.0


def _files(request: CertifyRequest) -> list[dict[str, Any]]:
    """Copy certificate and report out of their directory, where the page can fetch them, and return them."""
    assert request.out is not None
    found = list[dict[str, Any]]()
    for title, name, source in (("Certificate", FILE, FILE), ("Report", REPORT, "report.html")):
        content = (request.out / source).read_bytes()
        with written_whole(request.out.with_name(name)) as path:
            Path(path).write_bytes(content)
        kind = "json" if name.endswith(".json") else "html, opens offline"
        found.append({"title": title, "name": name, "kind": f"{kind}, {max(1, round(len(content) / 1000))} kB"})
    return found
