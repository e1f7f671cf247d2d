"""Studies: many variants of a job, swept on the cores of this machine or on a cluster, and what follows from them."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "answers.answers": "Answers answers_of",
        "answers.page": "write_report",
        "chunk": "run_chunk",
        "robust": "Robust tune_robust",
        "store": "Manifest Store",
        "study": "Bound Study read_study",
        "sweep": "Sweep",
        "variants": "VariantGroup variant_groups Variants variants",
    },
)
