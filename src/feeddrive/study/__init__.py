"""Studies: many variants of a job, swept on the cores of this machine or on a cluster, and what follows from them."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "answers.answers": "Answers answers_of",
        "answers.page": "write_report",
        "chunk": "run_chunk",
        "robust": "Robust tune_robust",
        "specification": "Bound",
        "store": "Manifest Store",
        "study": "Study read_study",
        "sweep": "Sweep",
        "variant_groups": "VariantGroup variant_groups",
        "variants": "Variants variants",
    },
)
