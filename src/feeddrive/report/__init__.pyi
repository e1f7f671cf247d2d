"""Reports: a value of verdict, pictures, tables and texts, and its writer. `html(report)` returns a page."""

# written by `make stubs`

from feeddrive.report.laws import Entry as Entry
from feeddrive.report.laws import LawsContents as LawsContents
from feeddrive.report.laws_report import laws_report as laws_report
from feeddrive.report.machining_report import circle_report as circle_report
from feeddrive.report.machining_report import plan_report as plan_report
from feeddrive.report.page import html as html
from feeddrive.report.report import Code as Code
from feeddrive.report.report import Facts as Facts
from feeddrive.report.report import Marked as Marked
from feeddrive.report.report import Picture as Picture
from feeddrive.report.report import Remarks as Remarks
from feeddrive.report.report import Report as Report
from feeddrive.report.report import Section as Section
from feeddrive.report.report import Verdict as Verdict
