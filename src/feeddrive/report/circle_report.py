"""The report of a circular test: the circle plot, unrolled circles, figures, and what draws them."""

from __future__ import annotations

from feeddrive import plot
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.machining.circle_causes import CircleCauses
from feeddrive.machining.circle_test import CircleTest, peaks_table
from feeddrive.report.report import Picture, Report, Section, Verdict, facts, further, titled
from feeddrive.version import __version__


def circle_report(test: CircleTest, causes: CircleCauses, note: str = "") -> Report:
    """Return the report of a circular test; `note`: a line for the circle plot."""
    pictures = [
        Picture(
            "circle",
            "Circle plot",
            "Deviations from the nominal circle, enlarged; a ring is a division. Dots: where a circle begins; arrows: "
            "its direction.",
            "Radial deviations on the nominal circle, in both directions.",
            lambda: plot.circle_test_chart(test, remark=note),
        ),
        Picture(
            "unrolled",
            "Over the angle",
            "The same over the polar angle; hollow: the peak behind each reversal; below, "
            "ten degrees before and behind each reversal.",
            "Radial deviations over the angle, with zooms of the reversals.",
            lambda: plot.circle_unrolled_chart(test),
        ),
        Picture(
            "causes",
            "What draws it",
            "The largest deviation that each cause draws on one of the circles; hatched: it cannot be told apart from "
            "another one.",
            "Causes by the largest deviation that they draw.",
            causes.chart,
        ),
    ]
    first = test.circles[0]
    known = [
        ("Circles", ", ".join(path.name for path in test.circles)),
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
    ranked = [cause for cause in causes.ranked if cause.effect > 0.0][:3]
    told = joined(", ", (f"{cause.name} {Quantity(cause.effect, 'm'):3}" for cause in ranked))
    peaks = "Quadrant peaks: outward, in the 10° after a reversal, above the mean of the 10° before it."
    tables = (
        titled(test.table(), "Circular test after ISO 230-4."),
        titled(peaks_table(test), peaks),
        titled(causes.table(), "What draws the deviations."),
    )
    shown, *others = pictures
    return Report(
        "Circular test",
        "feeddrive circle",
        Verdict((largest, Text(f"What draws most: {told}."))),
        (Section("figures", "Figures", tables), further(others), facts("What was measured", known)),
        shown,
    )
