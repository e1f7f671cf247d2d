"""Evaluation of cases in this process, on all cores or on a Dask cluster; an evaluation can be stopped and resumed."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "case": "Case content_digest",
        "designs": "Designs",
        "engine": "Bar Engine",
        "robustness": "Design Rule",
        "scheduler": "Certificates",
        "store": "Folder Store",
    },
)
