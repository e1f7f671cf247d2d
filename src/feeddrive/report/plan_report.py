"""The report of a plan: cycle time and where it goes, the path, the course of each axis, the stops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive import plot
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.path.planned import Planned
from feeddrive.report.report import Part, Picture, Report, Section, Verdict, facts, further, titled
from feeddrive.version import __version__

_LISTED = 200  # stops


def plan_report(plan: Planned) -> Report:
    """Return the report of a plan."""
    pictures = _pictures(plan)
    known = [
        ("Program", plan.program),
        ("Machine", plan.machine),
        ("Setpoints", Text(f"{plan.samples:,}, one every {Quantity(plan.sample_time, 's'):3}")),
        ("Blocks", f"{plan.blocks:,} that move, in {plan.runs:,} runs from rest to rest"),
        ("Proof", _proof(plan)),
        ("feeddrive", __version__),
    ]
    return Report(
        f"{plan.program}: plan",
        "feeddrive plan",
        Verdict(_lead(plan), good=plan.proof.count == 0),
        (
            Section("limits", "Limits", (titled(plan.table(), "The largest share of each limit that is used."),)),
            further(pictures[1:]),
            Section("stops", "Stops", _stops(plan), folded=True),
            facts("What was planned", known),
        ),
        next(iter(pictures), None),
    )


def _lead(plan: Planned) -> Sequence[str]:
    proof = plan.proof
    held = (
        "Every limit is proven to hold in continuous time, joints included."
        if proof.count == 0
        else f"{proof.count} violations, the first at {plan.limits.named(str(proof.faults[0]))}: no setpoints were "
        "written. This is a fault of feeddrive, not of the program."
    )
    first = Text(f"The cycle takes {Quantity(plan.cycle_time, 's'):6 SI}, with {plan.stop_count:,} stops. {held}")
    most = sorted(plan.seconds.items(), key=lambda item: -item[1])[:3] if plan.cycle_time else []
    told = joined(", ", (f"{name} {Quantity(seconds / plan.cycle_time, 'share'):3}" for name, seconds in most))
    return [first, Text(f"What limits it for most of the time: {told}.")] if most else [first]


def _proof(plan: Planned) -> str:
    return (
        f"{plan.proof.spans:,} spans of time by interval arithmetic, within 1e-9 of each limit; the largest jump at a "
        f"joint is {number(plan.proof.jump, 2)} of a limit"
    )


def _pictures(plan: Planned) -> Sequence[Picture]:
    letters = plan.limits.letters
    if not len(plan.course.time) or not plan.cycle_time:
        return []
    return [
        Picture(
            "path",
            "Path and speed",
            "Color and width: the speed along the path, slow is warm and wide. Dotted: traverses. Circles: stops, the "
            "first 300." + (" Of the speed 1 rad counts as 1 m." if plan.limits.rotary else ""),
            f"The path of {plan.program} with its speed as color.",
            plan.chart,
        ),
        Picture(
            "causes",
            "What limits the speed, and when",
            "A row for each limit; it is filled where this limit is used most, and its share of the cycle time stands "
            "behind its name. Feed: the program asks for no more. None above half: ends of ramps, and "
            "what a bend ahead or behind holds at its speed.",
            "Which limit is used most, over time.",
            lambda: plot.plan_causes_chart(plan),
        ),
        *(
            Picture(
                f"axis{letter}",
                f"Axis {letter}",
                "From the least to the most in each stretch of time; dashed: the limits, where they are near.",
                f"Velocity, acceleration, jerk and snap of axis {letter} over time with their limits.",
                lambda i=i: plot.plan_profiles_chart(plan, i),
            )
            for i, letter in enumerate(letters)
            if np.any(plan.proof.use[i] > 0.0)
        ),
    ]


def _stops(plan: Planned) -> list[Part]:
    if not plan.stops:
        return ["None: the program is one motion."]
    by_reason = sorted(plan.stop_reasons.items(), key=lambda item: -item[1])
    rows = [
        [
            stop.time,
            stop.line,
            str(stop),
            stop.duration,
            ", ".join(
                f"{letter} {number(factor * x, 6)}"
                for letter, (factor, _), x in zip(plan.limits.letters, plan.limits.shown, stop.position, strict=True)
            ),
        ]
        for stop in plan.stops[:_LISTED]
    ]
    caption = f"The first {_LISTED} of {plan.stop_count:,}." if plan.stop_count > _LISTED else "All of them."
    place = "place mm, deg" if plan.limits.rotary else "place mm"
    columns = [Column("time", "s", "SI"), "line", "reason", Column("stands", "s", "SI"), place]
    reasons = Table("Stops by reason.", ["reason", "stops"], [[name, f"{count:,}"] for name, count in by_reason])
    return [reasons, Table(caption, columns, rows)]
