"""The picture of the benchmark: what each law wins and loses against P-PI, plant by plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from feeddrive.plot.chart import DOTS, LOG, MARKERS, NEUTRAL, Abscissa, Chart, Curve, Level, Panel, Tick, listed


def scores_chart(laws: Sequence[str], panels: Mapping[str, Sequence[tuple[Sequence[float], float | None]]]) -> Chart:
    """A panel a figure and a row a law: a small dot for each plant, a large one for the geometric mean.

    panels  by headline, for each law its ratios to P-PI and their mean
    """
    shown = list[Panel]()
    for head, rows in panels.items():
        plants = [(ratio, -row) for row, (ratios, _) in enumerate(rows) for ratio in ratios]
        means = [(mean, -row) for row, (_, mean) in enumerate(rows) if mean]
        x, y = np.array(plants, float).reshape(-1, 2).T
        middle = np.array(means, float).reshape(-1, 2).T
        curves = (
            Curve(x, y, number=NEUTRAL, look=DOTS),
            Curve(middle[0], middle[1], look=MARKERS),
        )
        names = tuple(Tick(tick.value, tick.name if not shown else "") for tick in listed(laws))
        one = Level(1.0, upright=True)
        shown.append(
            Panel(
                "",
                curves,
                levels=(one,),
                ticks=names,
                low=0.4 - len(laws),
                high=0.6,
                caption=head,
                abscissa=Abscissa("", LOG),
            )
        )
    return Chart("", tuple(shown), across=len(shown), height=1.0 + 0.2 * len(laws))
