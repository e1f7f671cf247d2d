"""The picture of a wall: its height as color over feed and height, and a profile along the feed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot.chart import ALERT, Chart, Curve, Field, Heat, Level, Panel
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from feeddrive.machining.surface import Surface


def surface_chart(surface: Surface) -> Chart:
    """Height map in µm, and below it the profile at the tip beside the closed form of the feed mark."""
    along = 1e3 * (surface.along - surface.along[0])
    off = 1e6 * surface.map
    mark = Level(float(np.min(off[0])) + 1e6 * surface.mark, dashed=True, number=ALERT, caption="feed mark alone")
    ra, rz = surface.roughness
    profile = Panel(
        f"left of\nmaterial ({unit_name('um')})",
        (Curve(along, off[0], "profile at the tip"),),
        levels=(mark,),
        share=2.0,
        caption=Text(f"Ra {Quantity(ra, 'm'):3}, Rz {Quantity(rz, 'm'):3} of the patch"),
    )
    panels = [profile]
    if len(surface.heights) > 1:
        heat = Heat(f"left of material ({unit_name('um')})", float(np.min(off)), float(np.max(off)))
        field = Field(along, 1e3 * surface.heights, off)
        panels.insert(0, Panel("above the tip (mm)", field=field, heat=heat, share=3.0))
    return Chart("along the feed (mm)", tuple(panels), height=4.6 if len(panels) > 1 else 2.8)


surface = figure_of(surface_chart)
