"""The commands as functions with declared requests, one module each; `command.py` lists them."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "adjust": "adjust",
        "benchmark": "benchmark",
        "certify": "certify read_certificate write_certificate",
        "channels": "channels",
        "check": "check",
        "circle": "circle",
        "cogging": "cogging",
        "command": "Outcome",
        "commission": "commission",
        "compare": "compare",
        "doctor": "doctor",
        "excite": "excite",
        "export": "export verify",
        "follow": "follow",
        "force": "force",
        "frf": "frf",
        "friction": "friction",
        "identify": "identify",
        "learn": "iterate prefilter",
        "setpath": "setpath",
        "lobes": "lobes",
        "new": "new",
        "plan": "plan",
        "play": "listen play virtual_drive",
        "reproduce": "reproduce",
        "run_job": "cosimulate demo run write_results",
        "sweep": "sweep",
        "tour": "tour",
        "travel": "travel",
        "tune": "tune",
    },
)
