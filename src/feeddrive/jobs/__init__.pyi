"""Execution of jobs: every law of a job with the same motion and loads, along its log or part program, with figures."""

# written by `make stubs`

from feeddrive.jobs.run_laws import JobResult as JobResult
from feeddrive.jobs.run_laws import job_report as job_report
from feeddrive.jobs.run_laws import run_laws as run_laws
