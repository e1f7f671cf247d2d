"""`feeddrive frf`: a frequency response from one or more logs, its files and its report."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from feeddrive.files.atomic_io import new_directory
from feeddrive.files.columns import Column, check_sign, unit_of
from feeddrive.files.frf import write_frf
from feeddrive.files.log import Log, LogLike
from feeddrive.files.mapping import MappingLike, guess_roles
from feeddrive.files.names import unit_in_name
from feeddrive.files.read_log import LogRequest, OpenedFile, read_log
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate, Record
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError, nearest
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.table import Cell, Table
from feeddrive.language.table import Column as TableColumn
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import TRUSTED
from feeddrive.report.page import html
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts
from feeddrive.workflow.channels import check_response, doubt, requested, show, units_first, whole_log, with_units
from feeddrive.workflow.command import (
    CHANNELS,
    OUT,
    UNIT,
    Outcome,
    Request,
    argument,
    called,
    command,
    frequencies,
    line,
    option,
)
from feeddrive.workflow.drive_logs import log_stem

# usual column names of each role, in order of preference
_INPUT = ("force", "torque", "current", "command", "iq")
_REFERENCE = ("excitation", "added_force", "reference")
# pairs of usual encoder names, in order of preference
_OUTPUTS = (
    ("position_load", "reading_load", "position_motor", "reading_motor"),
    ("angle_load", "angle_motor"),
    ("velocity_load", "velocity_motor"),
    ("speed_load", "speed_motor"),
)
_ONE_OUTPUT = ("position", "y", "x")
# A and V stay as they are: the constant of the motor is not known here
_SI = ("m", "m/s", "m/s2", "N", "rad", "rad/s", "N m", "A", "V")
_FLAGS = {**dict.fromkeys((name for kind in _OUTPUTS for name in kind), "--output"), **dict.fromkeys(_INPUT, "--input")}


class FrfRequest(Request):
    """The logs of one measurement, the roles of their columns, and the estimator."""

    logs: tuple[LogLike, ...] = argument("Logs of the same measurement (MAT, CSV, Parquet), one a realisation")
    input: str | None = option("column of the input, name or name:unit", default=None)
    output: tuple[str, ...] = option("column of an output, name or name:unit; may be repeated", default=())
    reference: tuple[str, ...] = option(
        "column of the signal that was added to the loop; none: without one", default=()
    )
    method: str = option(
        "estimator: auto, periodic, impact, local-polynomial, h1, h2, hv, indirect or joint", default="auto"
    )
    band: str | None = option("band in Hz, as 5..500", default=None)
    period: int | None = option("samples of one period; found if left out", default=None)
    skip: int | None = option("periods dropped at the start; by a test", default=None)
    segment: int | None = option("samples of a stretch of averaged spectra", default=None)
    sample_time: float | None = option("sample time of logs without a clock", unit="s", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    unit: tuple[str, ...] = option(UNIT, default=())
    channels: MappingLike | None = option(CHANNELS, default=None)
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"frf_{log_stem(called(self.logs[0]))}"


@command(FrfRequest)
def frf(request: FrfRequest, progress: Progress) -> Outcome[Sequence[FrequencyEstimate]]:
    """Estimate a frequency response with coherence, variance, noise and distortion from measured logs.

    The result has one estimate per output.  Raises LogError for an unusable log.
    """
    logs, references = [OpenedFile(log) for log in request.logs], request.reference
    unnamed = request.input is None and not request.output
    read, doubted = _read(logs, unnamed, request, progress)
    inside = None if request.band is None else frequencies(request.band)
    estimates: list[FrequencyEstimate] = []
    shown: list[Table | str] = []
    of_input = request.input or _input(read[0])
    outputs = request.output or _outputs(read[0])
    for k, output in enumerate(outputs):
        progress.step(f"response of {output}", k, len(outputs))
        records = [_record(log, of_input, output, references) for log in read]
        estimate = estimate_frf(
            records,
            method=request.method.replace("-", "_"),
            band=inside,
            period=request.period,
            skip=request.skip,
            segment=request.segment,
        )
        # the sizes of a log with given roles were checked as it was read; an impact test identifies modes, not the mass
        if request.channels is None and "blows" not in estimate.counts:
            doubted += _check_mass(read[0].name, estimate, of_input, output, progress)
        estimates.append(estimate)
        shown += [estimate.table(), *([levels(estimate)] if estimate.levels else [])]
        shown += [f"- {text}" for text in (*sentences(estimate), *estimate.remarks)]
    used = {of_input, *(estimate.frf.output for estimate in estimates), *_references(read[0], references)}
    remarks = [
        f"{log.name}: {remark}" for log in read for remark in log.remarks if any(f"'{name}'" in remark for name in used)
    ]
    doubts = _doubts(read[0], {"input": [of_input], "output": outputs}, references)
    files: dict[str, Path] = {}
    known = {
        "Logs": ", ".join(str(log) for log in logs),
        "Input": estimates[0].frf.input,
        "Output": ", ".join(estimate.frf.output for estimate in estimates),
        "Reference": ", ".join(map(_plain, _references(read[0], references))) or "none",
        "Sample time": Text(f"{Quantity(read[0].sample_time, 's'):6}"),
        **({"In doubt": " ".join((*doubted, *doubts))} if doubted or doubts else {}),
    }
    judged_by = units_first(doubted) or _advice(estimates)
    page = partial(estimates_report, estimates, known, judged_by)
    if request.out is not None:
        progress.step("report")
        report = write_estimates(estimates, request.out, page())
        files |= {"Report": report, "Responses": report.parent / "frf.csv"}
    judgment, verdict = judged_by or (Judgment.DONE, "")
    # of two encoders the one whose name says so is at the motor
    seen = sorted((estimate.frf.output for estimate in estimates), key=lambda name: "motor" not in name)
    named = [word for pair in zip(("--motor", "--load"), seen, strict=False) for word in pair] if len(seen) > 1 else []
    then = "" if judgment.bad or "Responses" not in files else line("identify", files["Responses"], *named)
    return Outcome(estimates, shown, [*remarks, *doubts], verdict, files=files, judgment=judgment, page=page, then=then)


def _advice(estimates: Sequence[FrequencyEstimate]) -> Advice | None:
    """Return the judgment on the first estimate whose coherence is poor at the majority of frequency lines, or None."""
    for estimate in estimates:
        assert estimate.frf.coherence is not None
        poor = float(np.mean(estimate.frf.coherence <= TRUSTED))
        if poor > 0.5:
            return Judgment.INCOHERENT.because(
                f"the coherence of '{estimate.frf.output}' is {number(TRUSTED)} or less on "
                f"{Quantity(poor, 'share'):3} of the lines; measure again with more amplitude or longer"
            )
    return None


def _read(
    files: Sequence[OpenedFile], unnamed: bool, request: FrfRequest, progress: Progress
) -> tuple[list[Log], list[str]]:
    """Read the logs; column roles are taken from a TOML file, from options or from column names, or else are guessed.

    Also return the reasons why a log with given units is implausible.
    """
    channels, time, sample_time, unit = request.channels, request.time, request.sample_time, request.unit
    doubted: list[str] = []
    if channels is not None:
        logs = [_by_roles(requested(channels, file.path), time, sample_time, unit, progress, doubted) for file in files]
        return logs, doubted
    time_ = None if time is None else Column.of(time)
    read = [whole_log(file, time_, sample_time, str(file)) for file in files]
    # a log with a usual name for both input and output needs no guess
    usual = {*_INPUT} & {*read[0].channels} and {*_ONE_OUTPUT, *(n for kind in _OUTPUTS for n in kind)} & {
        *read[0].channels
    }
    if not unnamed or usual:
        return read, doubted
    guess = guess_roles(read[0])
    show(guess, files[0], progress)
    if not guess.mapping:
        # all columns need a factor: keep them, so that the error names them
        return read, doubted
    told = {} if time_ is None else {"time": time_}
    roles = with_units(files[0], guess.mapping, unit)
    read = [read_log(file, {**roles, **told}, sample_time=sample_time, name=str(file)) for file in files]
    sure = [role for role, column in roles.items() if column != guess.mapping[role]]
    return read, _check_sizes(files[0], read[0], roles, sure, progress)


def _check_sizes(
    file: OpenedFile, log: Log, roles: Mapping[str, Column], told: Collection[str], progress: Progress
) -> list[str]:
    """Raise LogError for a log that is implausible for a feed drive; if its units were given, return the reason."""
    doubtful = doubt(file, log, roles, told, _FLAGS, steady=True)
    doubtful.stop(progress)
    return [doubtful.why] if doubtful.why else []


def _check_mass(
    where: str, estimate: FrequencyEstimate, of_input: str, of_output: str, progress: Progress
) -> list[str]:
    """Raise LogError for a mass that is implausible for a feed drive; if the units were given, return the reason.

    A response without a unit cannot be checked here; the command that uses it checks it.
    """
    if not estimate.frf.unit:
        return []

    def cure(unit: str) -> str:
        output, _, force = unit.rpartition("/")
        return f"--output '{_plain(of_output)}:{output.strip('()')}' --input '{_plain(of_input)}:{force}'"

    told = all(Column.of(column).unit or Column.of(column).factor is not None for column in (of_input, of_output))
    return [*filter(None, [check_response(where, estimate.frf, told, progress, cure)])]


def _by_roles(
    request: LogRequest,
    time: str | None,
    sample_time: float | None,
    unit: Sequence[str],
    progress: Progress,
    doubted: list[str],
) -> Log:
    """Read a log with the roles of a TOML file; columns named on the command line take precedence."""
    file = OpenedFile(request.path)
    told = {} if time is None else {"time": Column.of(time)}
    roles = with_units(file, {**request.mapping, **told}, unit)
    mapping = replace(request.mapping, columns=roles, sample_time=sample_time or request.mapping.sample_time)
    log = replace(request, mapping=mapping).read().from_row(request.skip_samples)
    sure = [role for role, column in roles.items() if column.unit or column.factor is not None]
    doubted += _check_sizes(file, log, roles, sure, progress)
    return log


def _record(log: Log, of_input: str, of_output: str, references: Sequence[str]) -> Record:
    """Return the record of the named channels of a log, in SI units where their units are known."""
    force, unit_in = _values(log, of_input)
    position, unit_out = _values(log, of_output)
    return Record(
        input=force,
        output=position,
        references=tuple(_values(log, name)[0] for name in _references(log, references)),
        sample_time=log.sample_time,
        input_name=_plain(of_input),
        output_name=_plain(of_output),
        unit=_over(unit_out, unit_in) if unit_in and unit_out else "",
        name=log.name,
    )


def _over(output: str, source: str) -> str:
    """Return the unit of a response: m/N, and m/(m/s) of a commanded velocity."""
    return f"{output}/({source})" if "/" in source else f"{output}/{source}"


def _input(log: Log) -> str:
    """Return the first column with a usual name for the input. Raise LogError if there is none."""
    return next((name for name in _INPUT if name in log.channels), None) or _missing(log, "input", _INPUT[0])


def _outputs(log: Log) -> list[str]:
    """Return the columns with usual encoder names: load and motor, or one position. Raise LogError if none is found."""
    kinds = [[name for name in kind if name in log.channels] for kind in _OUTPUTS]
    both = next((kind for kind in kinds if kind), [])
    one = [name for name in _ONE_OUTPUT if name in log.channels]
    return both or one[:1] or [_missing(log, "output", _OUTPUTS[0][0])]


def _references(log: Log, told: Sequence[str]) -> list[str]:
    """Return the columns of the reference signals injected into the loop; by default, the first with a usual name."""
    named = [*told] or [name for name in _REFERENCE if name in log.channels][:1]
    return [name for name in named if name != "none"]


def _doubts(log: Log, columns: Mapping[str, Sequence[str]], references: Sequence[str]) -> list[str]:
    """Return sentences about missing information: the units of input and output, or a reference signal."""
    missing: list[str] = []
    for role, names in columns.items():
        missing += [
            f"No unit of '{_plain(name)}' is known, so that the response is in its numbers: name it, as "
            f"--{role} {_plain(name)}:{'N' if role == 'input' else 'mm'}."
            for name in names
            if not _values(log, name)[1]
        ]
    # in closed loop force and position are correlated through the noise: without a reference the estimate is biased
    if not _references(log, references):
        missing.append("No reference was given: if the loop was closed, name what was added to it with --reference.")
    return missing


def _missing(log: Log, role: str, usual: str) -> str:
    raise LogError(
        f"{log.name}: has no column that is named like an {role}{nearest(usual, log.channels)}: name it with --{role}"
    )


def _plain(named: str) -> str:
    return Column.of(named).name


def _values(log: Log, named: str) -> tuple[np.ndarray, str]:
    """Return the values of a channel, named as in `x`, `x:mm`, `x*2` or `x*2:mm`, in SI units if possible, and their
    unit.
    """
    column = Column.of(named)
    if column.name not in log.channels:
        raise LogError(f"{log.name}: there is no column '{column.name}'{nearest(column.name, log.channels)}")
    # `name*factor` leads to SI, `name*factor:unit` to that unit
    values, to_si = log[column.name], column.factor is not None and not column.unit
    unit = _known(named, column.unit) if column.unit else log.units.get(column.name, "") or unit_in_name(column.name)
    factor = 1.0 if column.factor is None else column.factor
    for si in _SI:
        try:
            size = units.factor(unit, si)
        except ParameterError:
            continue
        check_sign(log.name, column, unit, si)
        return values * (factor if to_si else factor * size), si
    return values * factor, "" if to_si else unit


def _known(named: str, unit: str) -> str:
    """Return a unit in the spelling of `language.units`. Raise ParameterError for an unknown unit."""
    known = unit_of(unit)
    if known is None:
        raise ParameterError(f"'{named}': the unit '{unit}' is not known; give one as mm, N, Nm, A, mdeg or rad")
    return known


def write_estimates(estimates: Sequence[FrequencyEstimate], out: str | Path, report: Report) -> Path:
    """Write `frf.csv` with all responses and `report.html` into a directory; return the report's path."""
    with new_directory(out) as folder:
        write_frf(folder / "frf.csv", *(estimate.frf for estimate in estimates))
        (folder / "report.html").write_text(html(report), encoding="utf-8")
    return Path(out) / "report.html"


def estimate_report(estimate: FrequencyEstimate) -> Report:
    """Return the report of one response."""
    return estimates_report((estimate,))


def estimates_report(
    estimates: Sequence[FrequencyEstimate], known: Mapping[str, str] | None = None, verdict: Advice | None = None
) -> Report:
    """Return the report of one or several responses, one section each; `known` holds facts about the measurement."""
    verdict = _advice(estimates) if verdict is None else verdict
    heads = [estimate.frf.output for estimate in estimates]  # the user's column names
    keys = [f"response{'abcdefghijkl'[k]}" for k in range(len(estimates))]
    lead: list[str] = [
        sentence if len(estimates) == 1 else Text(f"{name}: {sentence}")
        for name, estimate in zip(heads, estimates, strict=True)
        for sentence in sentences(estimate)
    ]
    counts = {"Method": estimates[0].method, **{name: str(count) for name, count in estimates[0].counts.items()}}
    pictures = [_picture(key, estimate) for key, estimate in zip(keys, estimates, strict=True)]
    first, *others = pictures
    return Report(
        f"Frequency response, {estimates[0].frf.input} to {' and '.join(heads)}",
        "feeddrive frf",
        Verdict(
            lead if verdict is None else (verdict.sentence, *lead), good=verdict is None or not verdict.judgment.bad
        ),
        (
            *(
                Section(key, head, (*shown, estimate.table(), levels(estimate), Remarks(estimate.remarks)))
                for key, head, estimate, shown in zip(
                    keys, heads, estimates, ((), *((one,) for one in others)), strict=True
                )
            ),
            facts("What was measured", {**(known or {}), **counts}),
        ),
        first,
    )


def _picture(key: str, estimate: FrequencyEstimate) -> Picture:
    return Picture(
        f"{key}picture",
        "Response, phase and coherence",
        "Band: the true response lies in it with 95 % on each line. Dots: what is not the linear answer, on the scale "
        "of the response; distortion only where the excitation left lines empty or the response scatters more than "
        "noise explains.",
        "Magnitude and phase over frequency with their confidence bands, and the coherence below.",
        estimate.chart,
    )


def sentences(estimate: FrequencyEstimate) -> list[str]:
    """Return sentences about the quality of an estimate: its standard deviation, and the frequency lines with poor
    coherence.
    """
    frf = estimate.frf
    assert frf.coherence is not None
    assert frf.variance is not None
    share = np.sqrt(frf.variance) / frf.magnitude
    good = float(np.mean(frf.coherence > TRUSTED))
    what = "noise and nonlinear distortion" if estimate.total else "noise"
    lead: list[str] = [
        Text(
            f"{frf.frequency.size} lines from {span(frf.frequency[0], frf.frequency[-1], 'Hz')}; the deviation by "
            f"{what} is {Quantity(np.median(share), 'share'):2} in the middle and {Quantity(np.max(share), 'share'):2} "
            f"at worst, at {Quantity(frf.frequency[int(np.argmax(share))], 'Hz')}."
        )
    ]
    if good < 1.0:
        low = frf.frequency[frf.coherence <= TRUSTED]
        lead.append(
            Text(
                f"The coherence is {number(TRUSTED)} or less on {Quantity(1.0 - good, 'share'):3} of the lines, "
                f"between {Quantity(low[0], 'Hz', bare=True)} and {Quantity(low[-1], 'Hz')}: do not tune on them; "
                "measure again there with more amplitude or longer."
            )
        )
    return lead


def levels(estimate: FrequencyEstimate) -> Table:
    """Tabulate noise and distortion relative to the response, as the median in each of six frequency bands."""
    f, size = estimate.frequency, estimate.frf.magnitude
    # the upper edge is exclusive: keep the last line below it
    edges = np.geomspace(f[0], f[-1] * (1.0 + 1e-9), 7)
    rows: list[list[Cell]] = []
    for low, high in pairwise(edges):
        row: list[Cell] = [Text(f"{span(low, high, 'Hz', between='..')}")]
        for name in ("noise", "nonlinear", "odd", "even"):
            level = estimate.levels.get(name)
            inside = None if level is None else (level.frequency >= low) & (level.frequency < high)
            if level is None or inside is None or not np.any(np.isfinite(level.response[inside])):
                row.append(None)
                continue
            # the levels are known on other lines than the response, some of them not excited
            share = level.response[inside] / np.interp(level.frequency[inside], f, size)
            row.append(float(np.nanmedian(share)))
        rows.append(row)
    columns = [TableColumn("band"), *(TableColumn(head, "share", "3") for head in ("noise", "scatter", "odd", "even"))]
    title = "Noise of the mean, scatter beyond noise, odd and even distortion: shares of the response (medians)."
    return Table(title, columns, rows)
