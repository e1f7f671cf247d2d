"""The report about laws over the same work: one self-contained HTML page. `build(contents)` returns its text."""

# written by `make stubs`

from feeddrive.report.circle_page import build_circle as build_circle
from feeddrive.report.laws_page import build as build
from feeddrive.report.page import Entry as Entry
from feeddrive.report.page import LawsReport as LawsReport
from feeddrive.report.plan_page import build_plan as build_plan
