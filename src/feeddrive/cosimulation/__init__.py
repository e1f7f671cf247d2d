"""Co-simulation: an FMU from another tool as the plant of a loop."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "simulate_with_fmu": "simulate_with_fmu",
    },
)
