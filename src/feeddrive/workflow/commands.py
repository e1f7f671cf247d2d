"""All commands by name: in which module of this room each stands, and what it does.

`from feeddrive.workflow.MODULE import NAME` gives the command (with _ for -).  The sentences stand here so that
`--help` need not import what the commands need.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from feeddrive.workflow.command import Command

COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("run_job", "Run the laws of a job over the same work and write a report, a summary and the signals."),
    "demo": (
        "run_job",
        "Run the bundled example: a real ball-screw axis under today's control and under three better ones.",
    ),
    "reproduce": (
        "reproduce",
        "Run a paper's experiments and write what it claims, by which rule, and what came out; 1 if a claim fails.",
    ),
    "prefilter": (
        "prefilter",
        "Fit the prefilter that cancels what a loop leaves of its tracking error, from one log.",
    ),
    "compare": (
        "compare",
        "Put all laws on one axis, tuned to equal robustness, beside today's gains, and rank them by criterion.",
    ),
    "iterate": (
        "iterate",
        "Learn mass, viscous and dry friction to feed forward from the error of a trial: a log, or simulated ones.",
    ),
    "frf": (
        "frf",
        "Estimate a frequency response with coherence, variance, noise and distortion from measured logs.",
    ),
    "excite": (
        "excite",
        "Design a multisine, check travel, speed and force by simulation, and write it to be sent to the drive.",
    ),
    "identify": (
        "identify",
        "Find mass, friction and dead time in a log, or masses and modes in frequency responses; with errors.",
    ),
    "channels": (
        "channels",
        "Guess which column of a log is what, and write it as a short TOML to correct and give with --channels.",
    ),
    "friction": (
        "friction",
        "Find the friction curve in runs of constant speed: models compared by evidence, parameters with errors.",
    ),
    "cogging": (
        "cogging",
        "Find the cogging of a motor in slow runs: its orders, with errors, and what changes sign with the direction.",
    ),
    "tune": (
        "tune",
        "Tune gains and filters of an axis within limits; write a machine file and a report before against after.",
    ),
    "certify": (
        "certify",
        "Prove a loop, as it will run, stable for plants with a disc around each; write a certificate and a report.",
    ),
    "check": (
        "check",
        "Check a certificate in exact arithmetic: 0 if it is proven, 1 with the reason if refused.",
    ),
    "export": (
        "export",
        "Write the control of an axis for a target: what is written computes what was simulated, bit for bit.",
    ),
    "verify": (
        "verify",
        "Run the equality proof of an export again, with this machine's compiler; 1 if anything differs.",
    ),
    "play": (
        "play",
        "Move an axis: play an excitation on a drive over EtherCAT or CANopen, within limits, and log what it did.",
    ),
    "listen": ("play", "Log a drive over its bus without switching it on."),
    "virtual-drive": (
        "virtual_drive",
        "Be a CiA 402 drive with the plant and the control of a machine file inside, until Ctrl-C.",
    ),
    "cosimulate": (
        "cosimulate",
        "Run the laws of a job against somebody else's model of the machine: an FMU in place of the plant.",
    ),
}


def load(name: str) -> Command[Any, Any, Any]:
    """The command of a name."""
    module, _ = COMMANDS[name]
    return getattr(import_module(f"feeddrive.workflow.{module}"), name.replace("-", "_"))
