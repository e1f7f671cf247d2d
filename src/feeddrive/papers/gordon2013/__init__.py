"""Gordon & Erkorkmaz 2013: pole placement with active damping, and a trajectory prefilter, on a ball screw."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

from feeddrive.blocks.plant.two_bodies import Gains
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import number
from feeddrive.papers.claims import Claim, Experiment
from feeddrive.papers.gordon2013 import frequency, motion, shipped
from feeddrive.papers.gordon2013.testbed import DESIGN, TRUTH, Part

_PARTS: tuple[tuple[str, Callable[[], Part]], ...] = (
    ("margins and stiffness", frequency.loop_figures),
    ("rope snap", motion.rope_snap),
    ("high-speed tracking", motion.tracking_error),
    ("frequency view of the contributions", frequency.frequency_view),
    ("ablation", motion.ablation),
    ("friction", motion.friction),
    ("machining", motion.machining),
    ("tooth passing", frequency.tooth_passing),
    ("robustness", frequency.robustness),
    ("another table, a clock that jitters", motion.other_axis),
    ("gains and poles", shipped.gains),
    ("force, commands and feedforward", shipped.commands),
    ("filter pack", shipped.filter_pack),
    ("damping of the axial mode", shipped.damping),
)


def _numbered(claims: Sequence[Claim]) -> list[Claim]:
    """Sort claims by their letters and give them short keys: 2.a1, 2.a2, ..."""
    count: Counter[str] = Counter()
    renamed: list[Claim] = []
    for claim in sorted(claims, key=lambda claim: claim.key.split()[0]):
        letter = claim.key.split()[0]
        count[letter] += 1
        renamed.append(replace(claim, key=f"{letter}{count[letter]}"))
    return renamed


def gordon2013(progress: Progress) -> Experiment:
    """Run all experiments of the paper; `progress` reports each step."""
    parts: list[Part] = []
    for words, run in _PARTS:
        progress.step(words)
        parts.append(run())
    gains = ", ".join(f"{name} {number(value, 5)}" for name, value in zip(Gains._fields, DESIGN.gains(), strict=True))
    return Experiment(
        name="gordon2013",
        title="Pole placement and trajectory prefilter on a ball screw",
        citation="Gordon & Erkorkmaz, Accurate control of ball screw drives using pole-placement vibration damping and "
        "a novel trajectory prefilter, Precision Engineering 37 (2013)",
        claims=_numbered([claim for part in parts for claim in part.claims]),
        tables=[table for part in parts for table in part.tables],
        pictures=[picture for part in parts for picture in part.pictures],
        facts={
            "plant": TRUTH,
            "model of the design": "130 kg and 33 kg, 18 N/µm, 700 N s/m, 1500 and 20 N s/m: two masses",
            "gains": f"{gains} (SI)",
            "filter pack": "notch 460 Hz (0.06 / 0.6) and low-pass 2.5 kHz, on the feedback only, both laws",
            "sample time": "50 µs",
        },
        notes=[
            "The paper's identified masses, poles and gains are not published: the plant is of the same order, and the "
            "expected figures are those of an independent computation on it.",
            "Peaks of the tracking error depend on how the last digits of timing are simulated (feedforward at the "
            "sample or in its middle, dwell in the record): they agree with the expected ones within 40 %, RMS within "
            "20 %; every claim states a ratio or an order.",
            "Where P-PI wins: stiffness around 60 Hz, tooth passing from 30 to 100 Hz. With the table at 43 kg and "
            "the screw 20 % softer at once the advantage in rope snap is 7 %.",
        ],
    )
