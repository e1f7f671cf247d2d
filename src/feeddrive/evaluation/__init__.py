"""One engine that evaluates cases: in this process, on its cores or on a Dask cluster, resumable."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "case": "Case content_digest",
        "designs": "Designs",
        "engine": "Bar Engine",
        "robustness": "Design Rule",
        "store": "Folder Store",
    },
)
