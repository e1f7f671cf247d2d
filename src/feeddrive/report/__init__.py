"""The report about laws over the same work: one self-contained HTML page. `build(contents)` returns its text."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "circle_page": "build_circle",
        "laws_page": "build",
        "page": "Entry LawsReport",
        "plan_page": "build_plan",
    },
)
