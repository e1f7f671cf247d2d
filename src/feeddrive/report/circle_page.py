"""The report of a circular test: the circle plot, unrolled circles, figures, and what draws them."""

from __future__ import annotations

from feeddrive import plot
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.machining.circle_causes import CircleCauses
from feeddrive.machining.circle_test import CircleTest, peaks_table
from feeddrive.report.page import Shown, definitions, header, page, picture, tabled
from feeddrive.version import __version__


def build_circle(test: CircleTest, causes: CircleCauses, said: str = "") -> str:
    """The report as one HTML page: no scripts, no other files. Pure: the same test gives the same text."""
    pictures = [
        Shown(
            "circle",
            "Circle plot",
            "Deviations from the nominal circle, enlarged; a ring is a division. Dots: where a circle begins; arrows: "
            "its direction.",
            "Radial deviations on the nominal circle, in both directions.",
            lambda: plot.circle_test(test, said=said),
        ),
        Shown(
            "unrolled",
            "Over the angle",
            "The same over the polar angle; hollow: the peak behind each reversal; below, "
            "ten degrees before and behind each reversal.",
            "Radial deviations over the angle, with zooms of the reversals.",
            lambda: plot.circle_unrolled(test),
        ),
        Shown(
            "causes",
            "What draws it",
            "The largest deviation that each cause draws on one of the circles; hatched: it cannot be told apart from "
            "another one.",
            "Causes by the largest deviation that they draw.",
            causes.plot,
        ),
    ]
    figures, peaks, split = test.table(), peaks_table(test), causes.table()
    first = test.circles[0]
    facts = [
        ("Circles", ", ".join(each.name for each in test.circles)),
        ("Nominal radius", Text(f"{Quantity(test.radius, 'm'):6 mm}, in {''.join(first.axes)}")),
        (
            "Measured by",
            "encoders, which do not see the tool" if first.source == "encoder" else "positions of the tool",
        ),
        ("Center of F", test.about),
        ("feeddrive", __version__),
    ]
    most = test.largest
    ways = "both directions, " if most.both else ""
    largest = Text(f"The circular deviation is {Quantity(most.G, 'm')} ({ways}{most.name}).")
    ranked = [each for each in causes.ranked if each.effect > 0.0][:3]
    told = joined(", ", (f"{cause.name} {Quantity(cause.effect, 'm'):3}" for cause in ranked))
    links = [
        ("figures", "Figures"),
        *((f"figure-{each.key}", each.title) for each in pictures),
        ("facts", "What was measured"),
    ]
    parts = [
        header("feeddrive circle", "Circular test", [largest, Text(f"What draws most: {told}.")], links),
        '<section id="figures"><h2>Figures</h2>',
        tabled(figures, "Circular test after ISO 230-4."),
        tabled(peaks, "Quadrant peaks: outward, in the 10° after a reversal, above the mean of the 10° before it."),
        tabled(split, "What draws the deviations."),
        "</section><section><h2>Pictures</h2>",
        *(picture(each) for each in pictures),
        '</section><section id="facts"><h2>What was measured</h2>',
        definitions(facts),
        "</section>",
    ]
    return page("Circular test", parts)
