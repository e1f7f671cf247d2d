"""Analysis of measured loops and estimation of responses against python-control and scipy, and what a report costs.

    python benchmarks/analysis.py

Each peer's figures are compared before it is timed: a tool that is quick and wrong is said to be so.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace

import control
import numpy as np
from rounds import machine, measure, ratio, table
from scipy import signal

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.jobs.run_laws import run_laws
from feeddrive.report import html, laws_report

ROUNDS = 15
LINES = 2000
SAMPLES = 2**20
SEGMENT = 4096


def shown(title: str, calls: Mapping[str, tuple[Callable[[], object], str]]) -> None:
    """One table: the first candidate is ours and the base of the ratios; beside each how far off its figures are."""
    ours = next(iter(calls))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        taken = measure({name: call for name, (call, _) in calls.items()}, ROUNDS)
    rows = [
        [name, f"{1e3 * np.median(taken[name]):.3g}", f"{ratio(taken, name, ours):.3g}", off]
        for name, (_, off) in calls.items()
    ]
    table([title, "CPU ms", "times ours", "off by"], rows)


def apart(values: np.ndarray, truth: np.ndarray) -> str:
    """Largest relative difference where it matters to a loop, at |L| > 0.01."""
    matters = np.abs(truth) > 0.01
    return f"{np.max(np.abs(np.asarray(values).reshape(-1)[matters] / truth[matters] - 1.0)):.1e}"


def margins_of(loop: fd.Loop) -> None:
    """All margins of 2000 complex numbers."""
    L = fd.loop_gain(loop, np.geomspace(1.0, 0.5 / loop.sample_time, LINES))
    theirs = replace(L, sample_time=None).to_control()
    found = fd.margins(L)
    gm, pm, sm, wpc, wgc, _ = control.stability_margins(theirs, returnall=True)
    # each crossing of ours beside its nearest of theirs; one of theirs is the rounding of a zero at Nyquist
    pairs = [(c.phase_margin_deg, pm[np.argmin(np.abs(wgc / 2 / np.pi - c.frequency))]) for c in found.gain_crossovers]
    pairs += [
        (c.gain_margin_dB, 20 * np.log10(gm[np.argmin(np.abs(wpc / 2 / np.pi - c.frequency))]))
        for c in found.phase_crossovers
    ]
    off = max(abs(b / a - 1.0) for a, b in [*pairs, (found.modulus_margin, np.min(sm))])
    more = len(wgc) + len(wpc) - len(pairs)
    noisy = replace(L, variance=(0.02 * L.magnitude) ** 2)
    shown(
        f"margins of {LINES} lines",
        {
            "feeddrive, margins": (lambda: fd.margins(L), "0"),
            "python-control, stability_margins of the FRD": (
                lambda: control.stability_margins(theirs, returnall=True),
                f"{off:.1e}; {more} crossings more",
            ),
            "feeddrive, encirclement": (lambda: fd.analysis.encirclement(L), ""),
            "feeddrive, margin_intervals, 200 draws": (lambda: fd.analysis.margin_intervals(noisy), ""),
        },
    )


def response_of(loop: fd.Loop) -> None:
    """The frequency response of a sampled model of the loop, cut at the force."""
    both = loop_model(loop)
    model = fd.linearize(loop, ["cut"], ["force"])
    frequency = np.geomspace(1.0, 0.49 / loop.sample_time, LINES)
    w = 2.0 * np.pi * frequency * loop.sample_time
    z = np.exp(1j * w)
    truth = model.response(frequency).response
    state_space = model.to_control()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = signal.dlti(model.A, model.B, model.C, model.D, dt=loop.sample_time)
        num, den = signal.ss2tf(model.A, model.B, model.C, model.D)
        shown(
            f"response of {model.A.shape[0]} states, {LINES} lines",
            {
                "feeddrive, response": (lambda: model.response(frequency), "0"),
                "feeddrive, loop_gain of an opened loop": (
                    lambda: both.loop_gain(frequency),
                    apart(-both.loop_gain(frequency).response, truth),
                ),
                "python-control, state space": (lambda: state_space(z), apart(state_space(z), truth)),
                "scipy, dfreqresp": (
                    lambda: signal.dfreqresp(system, w=w),
                    apart(signal.dfreqresp(system, w=w)[1], truth),
                ),
                "scipy, freqz of the polynomials": (
                    lambda: signal.freqz(num[0], den, worN=w),
                    apart(signal.freqz(num[0], den, worN=w)[1], truth),
                ),
            },
        )


def estimates() -> None:
    """H1 and coherence of 2^20 samples, Hann windows of 4096 that overlap by half."""
    random = np.random.default_rng(0)
    T = 1e-4
    u = random.standard_normal(SAMPLES)
    b, a = signal.butter(2, 300.0, fs=1.0 / T)
    y = signal.lfilter(b, a, u) + 0.01 * random.standard_normal(SAMPLES)
    record = fd.identification.Record(input=u, output=y, sample_time=T)

    def ours(method: str) -> fd.FRF:
        return fd.estimate_frf(record, method=method, **({"segment": SEGMENT} if method == "h1" else {})).frf

    def theirs() -> tuple[np.ndarray, np.ndarray]:
        _, cross = signal.csd(u, y, 1.0 / T, nperseg=SEGMENT)
        _, power = signal.welch(u, 1.0 / T, nperseg=SEGMENT)
        _, coherence = signal.coherence(u, y, 1.0 / T, nperseg=SEGMENT)
        return cross / power, coherence

    found, expected = ours("h1"), theirs()
    lines = np.rint(found.frequency * SEGMENT * T).astype(int)
    off = np.median(np.abs(found.response / expected[0][lines] - 1.0))
    shown(
        f"response, coherence from {SAMPLES} samples",
        {
            "feeddrive, h1 with variance": (lambda: ours("h1"), "0"),
            "scipy, csd, welch, coherence": (theirs, f"{off:.1e} in the median"),
            "feeddrive, local polynomials with variance": (lambda: ours("local_polynomial"), ""),
        },
    )


def main() -> None:
    print(machine(), "\n")
    job = fd.read_job("ball_screw")
    loop = job.loops["today"]
    margins_of(loop)
    response_of(loop)
    estimates()
    contents = run_laws(replace(job)).contents()
    report = measure({"report": lambda: html(laws_report(contents))}, 5)
    table(["report of three laws", "CPU s"], [["build", f"{np.median(report['report']):.2f}"]])


if __name__ == "__main__":
    main()
