"""The benchmark of control laws: fixed plants, versioned rules, stored designs, one table."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "benchmark": "Benchmark score search",
        "rules": "Plant Rules read_rules",
    },
)
