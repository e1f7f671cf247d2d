"""Studies: many variants of a job, computed on the cores of this machine or on a cluster, and their statistics."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "answers": "Answers answers_of",
        "chunk": "run_chunk",
        "page": "write_report",
        "robust": "Robust tune_robust",
        "store": "Manifest Store",
        "study": "Bound Study read_study",
        "sweep": "Sweep",
        "variants": "VariantGroup variant_groups Variants variants",
    },
)
