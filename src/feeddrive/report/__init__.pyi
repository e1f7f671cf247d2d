"""Reports as HTML pages; editors read this file, and the package loads the names on first use."""

from feeddrive.report.circle_page import build_circle as build_circle
from feeddrive.report.laws_page import build as build
from feeddrive.report.page import Entry as Entry
from feeddrive.report.page import LawsReport as LawsReport
from feeddrive.report.plan_page import build_plan as build_plan
