"""The benchmark of the field: fixed plants, rules with a version, stored designs, one table."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "benchmark": "Benchmark Row score",
        "designs": "Design Designs search",
        "rules": "Plant Rules read_rules",
    },
)
