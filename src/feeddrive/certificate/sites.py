"""The sites of a tuning as plants of a certificate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.certificate.certify import PlantLike
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.shaping.site import Site


def site_plants(sites: Sequence[Site | Loop]) -> dict[str, PlantLike]:
    """By name: the loops of models, and the lines of measurements with what smoothing left of their variance."""
    plants: dict[str, PlantLike] = {}
    for each in sites:
        name = each.name if isinstance(each, Site) else "model"
        count = sum(other == name or other.startswith(f"{name} ") for other in plants)
        plants[name if count == 0 else f"{name} {count + 1}"] = _plant(each)
    return plants


def _plant(site: Site | Loop) -> PlantLike:
    if isinstance(site, Loop):
        return site
    if site.loop is not None:
        return site.loop
    variance = np.zeros(site.by_force.shape) if site.variance is None else site.variance
    load = _response(site, 1, variance[1])
    if np.all(site.by_force[0] == site.by_force[1]):
        return load
    of_motor = variance[0]
    if site.ratio is not None:
        # where the ratio of both was fitted, the motor's line has the error of the load's, too
        tied = ~np.isnan(site.ratio[0])
        of_motor = of_motor + np.where(tied, np.abs(np.where(tied, site.ratio[0], 0.0)) ** 2 * variance[1], 0.0)
    return [load, _response(site, 0, of_motor)]


def _response(site: Site, row: int, variance: np.ndarray) -> FRF:
    output = ("reading_motor", "reading_load")[row]
    return FRF(site.frequency, site.by_force[row], "cut", output, "m/N", site.sample_time, None, variance)
