"""Reports: a value of verdict, pictures, tables and texts, and its writer. `html(report)` returns a page."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "laws": "Entry LawsContents",
        "laws_report": "laws_report",
        "machining_report": "circle_report plan_report",
        "page": "html",
        "report": "Code Facts Marked Picture Remarks Report Section Verdict",
    },
)
