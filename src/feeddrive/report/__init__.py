"""Reports: a value of verdict, pictures, tables and texts, and its writer. `html(report)` returns a page."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "circle_report": "circle_report",
        "laws": "Entry LawsContents",
        "laws_report": "laws_report",
        "page": "html",
        "plan_report": "plan_report",
        "report": "Code Facts Marked Picture Remarks Report Section Verdict",
    },
)
