"""Altintas & Okwudire 2009: DADSC with disturbance recovery on a linear motor, claim by claim."""

from feeddrive.language.progress import Progress
from feeddrive.papers.altintas2009 import recovery, shipped
from feeddrive.papers.altintas2009.equations import equations
from feeddrive.papers.altintas2009.recovery import estimation, machine_modes
from feeddrive.papers.altintas2009.rigidity import delays, motion, rigidity
from feeddrive.papers.altintas2009.testbed import PLANT
from feeddrive.papers.claims import Experiment


def altintas2009(progress: Progress) -> Experiment:
    """Run all experiments of the paper; `progress` reports each step."""
    progress.step("equations in the ideal loop")
    algebra, poles = equations()
    progress.step("shipped blocks against their equations")
    beside = [claim for row in (*shipped.ROWS, *recovery.ROWS) for claim in row()]
    progress.step("stiffness under four rules")
    stiff, stiff_pictures = rigidity()
    progress.step("disturbance recovery")
    seen, seen_tables, seen_pictures = estimation()
    progress.step("modes of the machine")
    modes, mode_tables, mode_pictures = machine_modes()
    progress.step("tracking and saturation")
    moved, moved_pictures = motion()
    progress.step("dead time")
    late, late_tables, late_pictures = delays()
    return Experiment(
        name="altintas2009",
        title="DADSC with disturbance recovery on a linear motor",
        citation="Y. Altintas, C. E. Okwudire: Dynamic stiffness enhancement of direct-driven machine tools using "
        "sliding mode control with disturbance recovery. CIRP Annals 58 (2009).",
        claims=[*algebra, *stiff, *seen, *modes, *moved, *late, *beside],
        tables=[*seen_tables, *mode_tables, *late_tables],
        pictures=[*poles, *stiff_pictures, *seen_pictures, *mode_pictures, *moved_pictures, *late_pictures],
        facts={
            "Plant": f"{PLANT}; the authors' own drive and gains are not public",
            "Laws": "DADSC with three equal rates p unless a row says otherwise; P-PI as the paper's cascade: position "
            "gain, PI velocity loop, acceleration feedforward and b x'",
            "Noise": "none, or a scale of 10 nm; random forces with the seeds that their rows name",
        },
        notes=(
            "Equation (2) is corrected (the mass in front of x_r'' is missing in print), and (8) (z² - z for z² - 1).",
            "That DADSC is stiffer than P-PI depends on the rule: it holds at equal velocity gain and real poles, and "
            "reverses under the paper's figure taken literally and under equal margins. Both laws are PIDs.",
            "The form of the mode compensation is this library's: the paper does not state one.",
        ),
    )
