"""Jobs that run: every law of a job over the same work, along its log or its part program, with its figures."""

# written by `make stubs`

from feeddrive.jobs.run_laws import JobResult as JobResult
from feeddrive.jobs.run_laws import job_report as job_report
from feeddrive.jobs.run_laws import run_laws as run_laws
