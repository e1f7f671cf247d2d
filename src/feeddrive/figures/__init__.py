"""The catalogue of figures of merit for loops, runs and machines, with the goals and limits of a tuning."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "catalogue": "figure figures goals limitable",
        "figure": "Figure Goal Limit Limitable Statistics",
        "of_loops": "LinearLoop",
        "slopes": "Slope",
    },
)
