"""Reports of a measurement: a frequency response that was estimated, an excitation that was designed."""

from feeddrive.workflow.certificate_file import read_certificate as read_certificate
from feeddrive.workflow.certificate_file import write_certificate as write_certificate
from feeddrive.workflow.job_results import write_results as write_results
from feeddrive.workflow.jobs import JobResult as JobResult
from feeddrive.workflow.jobs import run as run
