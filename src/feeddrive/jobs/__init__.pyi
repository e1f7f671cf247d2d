"""The run of a job: a study of one, whose cases are its laws."""

from feeddrive.jobs.run_laws import JobResult as JobResult
from feeddrive.jobs.run_laws import run_laws as run_laws
