"""The picture of a wall: its height as color over feed and height, and a profile along the feed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style

if TYPE_CHECKING:
    from feeddrive.machining.surface import Surface


def surface(found: Surface) -> Any:
    """Height map in µm, and below it the profile at the tip beside the closed form of the feed mark."""
    maps = len(found.heights) > 1
    figure, axes = style.picture(2 if maps else 1, height=4.6 if maps else 2.8, ratios=(3, 2) if maps else None)
    along = 1e3 * (found.along - found.along[0])
    off = 1e6 * found.map
    if maps:
        top = 1e3 * found.heights
        shown = axes[0].pcolormesh(along, top, off, cmap="viridis", shading="nearest", rasterized=True)
        figure.colorbar(shown, ax=axes[0], label=style.read(f"left of material ({unit_name('um')})"))
        axes[0].grid(visible=False)
        style.labels(axes[0], None, "above the tip (mm)")
    ax = axes[-1]
    ax.plot(along, off[0], label="profile at the tip", **style.curve(0))
    low = float(np.min(off[0]))
    ax.axhline(low + 1e6 * found.mark, color=style.ALERT, linewidth=1.0, linestyle=(0, (5, 2)), label="feed mark alone")
    style.labels(ax, "along the feed (mm)", f"left of\nmaterial ({unit_name('um')})")
    ra, rz = found.roughness
    style.note(ax, Text(f"Ra {Quantity(ra, 'm'):3}, Rz {Quantity(rz, 'm'):3} of the patch"))
    style.legend(figure, ax)
    return figure
