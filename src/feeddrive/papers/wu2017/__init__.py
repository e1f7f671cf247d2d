"""Wu, Han, Xiong & Ding 2017: iterative tuning of feedforward and disturbance compensator, claim by claim."""

from feeddrive.language.progress import Progress
from feeddrive.papers.claims import Experiment
from feeddrive.papers.wu2017 import shipped
from feeddrive.papers.wu2017.learning import contouring, learning, signals
from feeddrive.papers.wu2017.rates import rates
from feeddrive.papers.wu2017.testbed import PLANT


def wu2017(progress: Progress) -> Experiment:
    """Run all experiments of the paper; `progress` reports each step."""
    progress.step("trials along one and along changing references")
    learned, learned_tables, learned_pictures, _ = learning()
    progress.step("rates of convergence, noise")
    rated, rated_tables, rated_pictures = rates()
    progress.step("shipped blocks against their equations")
    beside = [claim for row in (*shipped.ROWS, shipped.believed_gains) for claim in row()]
    progress.step("circle of two axes")
    drawn, drawn_tables, drawn_pictures = contouring()
    progress.step("comparison with signal-based learning")
    signal, signal_tables, signal_pictures = signals()
    return Experiment(
        name="wu2017",
        title="Iterative tuning of feedforward and disturbance compensator",
        citation="J. Wu, Y. Han, Z. Xiong, H. Ding: Servo performance improvement through iterative tuning feedforward "
        "controller with disturbance compensator. International Journal of Machine Tools and Manufacture 117 (2017).",
        claims=[*learned, *rated, *drawn, *signal, *beside],
        tables=[*learned_tables, *rated_tables, *drawn_tables, *signal_tables],
        pictures=[*learned_pictures, *rated_pictures, *drawn_pictures, *signal_pictures],
        facts={
            "Plant": f"{PLANT}; the authors' rig and gains are not public",
            "Moves": "100 mm at 0.25 m/s, 3 m/s², 60 m/s³; 60 mm at 0.15, 2, 40; 200 mm at 0.4, 4, 80; 30 mm at 0.1, "
            "1.5, 50; out and back, boxcar of 4 ms, standstill of 20, 200 and 200 ms",
            "Noise": "5 N RMS white force in each sample, of the seeds that the rows name",
        },
        notes=(
            "Bars hold for tanh friction, with which the expected figures were computed by an independent program; "
            "set-valued friction is judged by its ordering only.",
            "Changing references end on the first move, so that the last trial can be compared with six equal ones.",
            "Standard errors do not include the bias of b and of the Coulomb levels by one sample of dead time: a jerk "
            "column removes it (see the page on iterative feedforward).",
            "On the circle mass and viscous friction of the axes are fed forward from the start, so that the columns a "
            "and b can only imitate friction.",
        ),
    )
