"""Jobs that run: every law of a job over the same work, along its log or its part program, with its figures."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "run_laws": "JobResult job_report run_laws",
    },
)
