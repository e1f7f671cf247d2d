"""What a plant that agrees with a measurement adds to it: the force on the table, and an axis with friction to run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning.shaping.control_response import ControlResponse
from feeddrive.tuning.shaping.site import Site

_WORST = 0.2  # of the response: a plant that is further off is another one
_COUNTS = 0.1  # |L| from which lines count
_FEWEST = 10
READINGS = ("reading_motor", "reading_load")


def disagreement(site: Site, loop: Loop, velocity: float = 0.05) -> float:
    """The median of |measured/model - 1| without the share of the noise, the worse of both readings.

    On the lines on which the loop gain of the loop's own control is 0.1 or more.
    """
    model = linearize(loop, ["cut"], READINGS, velocity=velocity)
    C = ControlResponse(loop.control, site.sample_time, (), velocity).at((), site.frequency).value
    gain = np.abs(np.einsum("kl,kl->l", C, site.by_force))
    lines = np.flatnonzero(gain >= _COUNTS)
    if lines.size < _FEWEST:
        lines = np.arange(site.frequency.size)
    off: list[float] = []
    for k, reading in enumerate(READINGS):
        if k == 0 and _one_encoder(site):
            continue
        true = model.response(site.frequency[lines], reading, "cut").response
        apart = np.abs(site.by_force[k, lines] / true - 1.0) ** 2
        noise = 0.0 if site.variance is None else np.median(site.variance[1, lines] / np.abs(true) ** 2)
        off.append(float(np.sqrt(max(np.median(apart) - noise, 0.0))))
    return max(off)


def with_table_force(
    site: Site, loop: Loop, source: str, velocity: float = 0.05, *, run: bool = True
) -> tuple[Site, str]:
    """The site with the responses of a plant to a force on the table, and how far it can be trusted in words.

    The plant must agree with the measured responses to 20 % (`disagreement`); by how much it does not is taken for the
    standard deviation of its answer, if the measurement has one.  A site that the plant does not fit comes back as it
    is.  One that was struck keeps its responses.

    run  what is tuned is also run on the loop, with its friction, counts and limits (`Site.known_as`)
    """
    off = disagreement(site, loop, velocity)
    if off > _WORST:
        nothing = "a force on the table, nor can the new control be run on it" if run else "a force on the table"
        apart = f"{source} is {100.0 * off:.3g} % off the response '{site.name}'"
        return site, f"{apart}, and so it says nothing on {nothing}"
    if run:
        site = replace(site, known_as=replace(loop, sample_time=site.sample_time))
    if not site.at_drive:
        return site, ""
    model = linearize(loop, ["cut", "load_force"], READINGS, velocity=velocity)
    found = {
        source: np.array([model.response(site.frequency, each, source).response for each in READINGS])
        for source in model.inputs
    }
    by_load = found["load_force"]
    # y = S y_d (1 - C_m y_u (r_u - r_d)), r = motor/load: by how much the ratios differ decides about stiffness, so the
    # plant gives the difference and not a second ratio, whose error would be as large as what is looked for
    apart = found["cut"][0] / found["cut"][1] - by_load[0] / by_load[1]
    if _one_encoder(site):
        apart = 0.0 * apart
    by_load = np.array([by_load[1] * (site.by_force[0] / site.by_force[1] - apart), by_load[1]])
    variance = None
    if site.variance is not None:
        spread = (off * np.abs(by_load)) ** 2
        variance = np.array([np.zeros(spread.shape[1]), spread[1]])
    ratio = None if site.ratio is None else np.array([site.ratio[0], by_load[0] / by_load[1]])
    moved = np.array([site.moved[0], by_load[1]])
    shown = (
        f"the force on the table is by {source}, which agrees with the response '{site.name}' within "
        f"{100.0 * max(off, 1e-3):.2g} %; a hammer on the table (--disturbance) would prove it"
    )
    return (
        replace(site, by_load=by_load, moved=moved, load_variance=variance, at_drive=False, ratio=ratio),
        shown,
    )


def _one_encoder(site: Site) -> bool:
    """Whether one encoder gives both readings."""
    return site.ratio is not None and bool(np.all(site.ratio[0] == 1.0))
