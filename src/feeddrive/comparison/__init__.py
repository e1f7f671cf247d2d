"""Comparison of all laws on one axis, with the same motions and loads, at equal robustness."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "compare": "Comparison compare_laws",
        "report": "write_comparison",
    },
)
