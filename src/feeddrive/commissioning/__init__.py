"""Commissioning: the motions of an unknown drive, what they tell, and the trial of a new control."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "motions": "Pace push strokes trial",
        "record": "Commissioned Step",
        "trial": "Figures Trial figures predicted",
    },
)
