"""What each command does, as a function with a declared request; `commands.py` lists them, one module each."""

from feeddrive.workflow.certificate_file import read_certificate as read_certificate
from feeddrive.workflow.certificate_file import write_certificate as write_certificate
from feeddrive.workflow.job_results import write_results as write_results
from feeddrive.workflow.jobs import JobResult as JobResult
from feeddrive.workflow.jobs import run as run
