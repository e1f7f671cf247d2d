"""Commissioning: the motions of an unknown drive, what they tell, and the trial of a new control."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "evidence": "Evidence Modelled read_evidence",
        "motions": "Pace push strokes trial",
        "record": "Commissioned Step read_commissioned",
        "trial": "Figures Trial figures predicted",
    },
)
