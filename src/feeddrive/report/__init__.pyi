"""Reports as HTML pages; editors read this file, and the package loads the names on first use."""

from feeddrive.report.circle_page import build_circle as build_circle
from feeddrive.report.page import Entry as Entry
from feeddrive.report.page import Study as Study
from feeddrive.report.plan_page import build_plan as build_plan
from feeddrive.report.study_page import build as build
