"""What each command does, as a function with a declared request; `command.py` lists them, one module each."""

from feeddrive.workflow.certify import read_certificate as read_certificate
from feeddrive.workflow.certify import write_certificate as write_certificate
from feeddrive.workflow.jobs import JobResult as JobResult
from feeddrive.workflow.jobs import run as run
from feeddrive.workflow.run_job import write_results as write_results
