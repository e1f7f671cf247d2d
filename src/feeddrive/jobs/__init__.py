"""Execution of jobs: every law of a job with the same motion and loads, along its log or part program, with figures."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "run_laws": "JobResult job_report run_laws",
    },
)
