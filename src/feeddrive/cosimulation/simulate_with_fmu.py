"""Co-simulation of a feeddrive controller with an FMU as its plant: one run, or a comparison of the laws of a job.

The FMU is unpacked, checked, mapped to the signals of the loop, stepped and closed.
An FMU is executable code: see `Instance`.  The units of its variables are converted to SI.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import tempfile
import zipfile
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.atomic_io import new_directory, read_whole, refusal
from feeddrive.files.job import Job
from feeddrive.files.origins import digest_of
from feeddrive.files.run_files import file_names, versions, write_run_csv, write_run_parquet
from feeddrive.language.errors import (
    DivergedError,
    FeeddriveError,
    FmuError,
    MissingExtraError,
    ParameterError,
    nearest,
)
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import factor, measure
from feeddrive.loop.loop import SETPOINT, UNITS, Loop, Signals
from feeddrive.loop.routine import ControllerRun, Routine, controller_routine
from feeddrive.loop.runner import Work
from feeddrive.loop.simulate import Run, sample_count

MOST_UNPACKED = 2_000_000_000  # bytes


@dataclass(frozen=True)
class Archive:
    """An unpacked FMU: its file, its description as read by FMPy, its folder, and its library for this machine."""

    name: str
    description: Any
    folder: Path
    library: Path

    @property
    def three(self) -> bool:
        """True for FMI 3.0, False for FMI 2.0."""
        return str(self.description.fmiVersion).startswith("3.")

    @property
    def model(self) -> str:
        """The model identifier, which is also the name of the library."""
        return self.description.coSimulation.modelIdentifier


@contextlib.contextmanager
def opened(path: str | Path) -> Generator[Archive]:
    """Unpack an FMU for the duration of the `with` block; none of its code is run yet.

    Raises FileError for a file that cannot be read, FmuError for a file that is not an FMU or has no co-simulation
    interface or no binary for this machine, and MissingExtraError if FMPy is not installed.
    """
    fmpy = importer()
    with tempfile.TemporaryDirectory(prefix="feeddrive-fmu-", ignore_cleanup_errors=True) as folder:
        try:
            with zipfile.ZipFile(path) as packed:
                # Before anything is extracted: the entries of a hostile archive may point outside the folder or fill
                # the disk.
                _check_entries(packed, path)
                packed.extractall(folder)
            # Not validated: descriptions of many tools violate the schema in details that a run does not need.
            description = fmpy.read_model_description(folder, validate=False)
        except OSError as error:
            raise refusal(path, "read", error) from None
        except FmuError:
            raise
        except Exception as error:
            # a damaged ZIP or XML file makes their readers raise many types of exception
            raise FmuError(f"{path}: is damaged or not an FMU: {_first_line(error)}") from None
        yield _checked(str(path), description, Path(folder))


def importer() -> Any:
    """Return the module FMPy; raise MissingExtraError if it is not installed."""
    try:
        import fmpy
    except ImportError:
        raise MissingExtraError("fmpy", "fmu", "running an FMU") from None
    return fmpy


def _check_entries(packed: zipfile.ZipFile, path: str | Path) -> None:
    """Check that an FMU has a description, that no file lies outside its folder, and that it is not too large."""
    names = packed.namelist()
    if "modelDescription.xml" not in names:
        raise FmuError(f"{path}: is not an FMU: it holds no modelDescription.xml")
    outside = [name for name in names if name.startswith(("/", "\\")) or ".." in Path(name).parts or ":" in name]
    if outside:
        raise FmuError(f"{path}: is not an FMU: its file '{outside[0]}' would lie outside its folder")
    size = sum(entry.file_size for entry in packed.infolist())
    if size > MOST_UNPACKED:
        raise FmuError(
            f"{path}: would take {Quantity(size / 1e9, 'GB'):3} unpacked, more than the "
            f"{Quantity(MOST_UNPACKED / 1e9, 'GB')} that are read"
        )


def _checked(name: str, description: Any, folder: Path) -> Archive:
    fmpy = importer()
    if description.fmiVersion == "1.0":
        raise FmuError(f"{name}: is of FMI 1.0; FMI 2.0 and 3.0 can be run")
    if description.coSimulation is None:
        raise FmuError(f"{name}: is not an FMU for co-simulation (it has no solver): export it for co-simulation")
    three = str(description.fmiVersion).startswith("3.")
    here = fmpy.platform_tuple if three else fmpy.platform
    file = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    library = folder / "binaries" / here / file
    if not library.is_file():
        there = sorted({built.parent.name for built in (folder / "binaries").glob("*/*") if built.is_file()})
        has = f"has binaries for {', '.join(there)}" if there else "has no binary"
        advice = f"compile it:  fmpy compile {name}" if description.buildConfigurations else "ask its maker for one"
        raise FmuError(f"{name}: {has}, but none for this machine ({here}): {advice}")
    return Archive(name, description, folder, library)


def _first_line(error: Exception) -> str:
    """Return the first line of an error's text, or its type."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


# signals from the loop to an FMU, and from an FMU to the loop
GIVEN = ("force", "command", "load_force", "start_position")
TAKEN = (
    "reading",
    "reading_motor",
    "reading_load",
    "position_motor",
    "position_load",
    "velocity_motor",
    "velocity_load",
    "drive_force",
    "friction_motor",
    "friction_load",
)
_BASE = ("m", "kg", "s", "A", "rad")  # in the order of `units.Dimension`
_REALS = ("Real", "Float64")


class Port(NamedTuple):
    """A variable of the FMU that carries a signal: value in SI = factor · value of the FMU."""

    signal: str
    variable: str
    reference: int
    factor: float


def ports(archive: Archive, names: Mapping[str, str], command_unit: str | None) -> dict[str, Port]:
    """Return the ports by signal: the variables given in `names`, and variables of the FMU that have the name of a
    signal.

    `names` are the FMU's variables by signal, as "x" or "x:mm"; a variable without a unit counts as SI. `command_unit`
    is the unit of the drive's command; None if there is no motor.

    Raises ParameterError for an unknown signal or a unit that does not fit, FmuError for a variable that is
    missing or of the wrong kind.
    """
    variables = {variable.name: variable for variable in archive.description.modelVariables}
    for signal in names:
        if signal not in (*GIVEN, *TAKEN):
            raise ParameterError(
                f"there is no signal '{signal}' to name a variable for{nearest(signal, GIVEN + TAKEN)}"
            )
    # force and command are the same drive in two units: a plant must receive one of them, not both
    both = {"force", "command"} & set(names)
    same_name = [
        signal for signal in (*GIVEN, *TAKEN) if signal in variables and not (signal in ("force", "command") and both)
    ]
    if not both and "force" in same_name and "command" in same_name:
        same_name.remove("command")
    wanted = {signal: signal for signal in same_name} | dict(names)
    return {signal: _port(archive, variables, signal, text, command_unit) for signal, text in wanted.items()}


def _port(archive: Archive, variables: Mapping[str, Any], signal: str, text: str, command_unit: str | None) -> Port:
    name, unit = text, ""
    if name not in variables and ":" in text:
        name, _, unit = text.rpartition(":")
    if name not in variables:
        raise FmuError(f"{archive.name}: has no variable '{name}' for {signal}{nearest(name, list(variables))}")
    variable = variables[name]
    causalities = _causalities(signal)
    if variable.causality not in causalities:
        raise FmuError(f"{archive.name}: '{name}' is {variable.causality}, but {signal} needs an {causalities[0]}")
    if variable.type not in _REALS or variable.dimensions:
        raise FmuError(f"{archive.name}: '{name}' is not a scalar of 64 bits, which {signal} needs")
    if signal == "command" and command_unit is None:
        raise ParameterError("command: the machine file names no motor, so that there is no command in a drive's unit")
    declared = (command_unit or "") if signal == "command" else _unit(signal)
    try:
        return Port(signal, name, variable.valueReference, _factor(archive, variable, unit, declared))
    except ParameterError as error:
        raise ParameterError(f"{archive.name}: '{name}' as {signal}: {error}") from None


def _causalities(signal: str) -> tuple[str, ...]:
    if signal == "start_position":
        return ("input", "parameter")
    return ("input",) if signal in GIVEN else ("output", "local")


def _unit(signal: str) -> str:
    return UNITS.get(signal, "m")  # readings without a side and the start are positions


def _factor(archive: Archive, variable: Any, unit: str, declared: str) -> float:
    """Return the conversion factor to `declared` from the unit given by the caller, or else from that stated in the
    FMU.
    """
    if unit:
        return factor(unit, declared)
    stated = variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)
    if not stated or stated == declared:
        return 1.0
    base = next(
        (definition.baseUnit for definition in archive.description.unitDefinitions if definition.name == stated), None
    )
    if base is None:
        return factor(stated, declared)
    powers = {name: int(getattr(base, name) or 0) for name in (*_BASE, "K", "mol", "cd")}
    size, dimension = measure(declared)
    wanted: dict[str, int] = dict(zip(_BASE, dimension, strict=True))
    # an offset (degrees Celsius, say) is no factor
    if any(power != wanted.get(name, 0) for name, power in powers.items()) or float(base.offset or 0.0) != 0.0:
        raise ParameterError(f"its unit '{stated}' does not measure the same thing as '{declared}'")
    return float(base.factor if base.factor is not None else 1.0) / size


def needed(ports: Mapping[str, Port], signals: Iterable[str], archive: Archive, who: str) -> None:
    """Raise FmuError unless all of these signals, which `who` needs, have a port."""
    missing = next((signal for signal in signals if signal not in ports), None)
    if missing is None:
        return
    kind = "input" if missing in GIVEN else "output"
    have = ", ".join(variable.name for variable in archive.description.modelVariables if variable.causality == kind)
    example = f'"x" or "x:{"N" if kind == "input" else "mm"}"'
    raise FmuError(
        f"{archive.name}: {who} needs {missing}, but no variable is named for it: name one, as {example}; "
        f"the FMU's {kind}s are: {have or 'none'}"
    )


_SETTERS = {
    "Real": "setReal",
    "Float64": "setFloat64",
    "Integer": "setInteger",
    "Int32": "setInt32",
    "Int64": "setInt64",
    "Boolean": "setBoolean",
}
_STATUS = {2: "refused the step (Discard)", 3: "failed (Error)", 4: "is beyond repair (Fatal)"}


class Instance:
    """An instance of an FMU for co-simulation, to be used in a `with` block.

    The FMU's code runs with all privileges of this process. Messages of the FMU are collected and quoted in errors.
    """

    def __init__(self, archive: Archive) -> None:
        """Load the FMU's library and instantiate it; raise FmuError if either fails."""
        self.archive = archive
        self.messages: list[str] = []
        import fmpy.fmi2
        import fmpy.fmi3

        kind = fmpy.fmi3.FMU3Slave if archive.three else fmpy.fmi2.FMU2Slave
        try:
            with contextlib.chdir(archive.folder):  # FMPy changes the folder, and stays there if it fails
                self.fmu: Any = kind(
                    guid=archive.description.guid,
                    modelIdentifier=archive.model,
                    unzipDirectory=str(archive.folder),
                    instanceName="plant",
                    libraryPath=str(archive.library),
                )
            # With logging on, since many FMUs explain a failure only in their log messages.
            if archive.three:
                self.fmu.instantiate(loggingOn=True, logMessage=self._heard3)
            else:
                # Kept as an attribute: the FMU calls them later, and ctypes frees callbacks that nothing refers to.
                self._callbacks = self._logging()
                self.fmu.instantiate(loggingOn=True, callbacks=self._callbacks)
        except Exception as error:  # FMPy raises bare exceptions
            needs = archive.description.coSimulation.needsExecutionTool
            hint = "; it needs the program that made it to be installed" if needs else ""
            raise FmuError(f"{archive.name}: cannot be started: {error}{self._words()}{hint}") from None

    def _logging(self) -> Any:
        """Return the callbacks of FMI 2, with a logger that accepts a variable number of arguments."""
        from fmpy import fmi2
        from fmpy.logging import addLoggerProxy

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._heard2)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def _heard2(self, _: Any, __: bytes, status: int, category: bytes, message: bytes) -> None:
        self._heard3(None, status, category, message)

    def _heard3(self, _: Any, status: int, category: bytes, message: bytes) -> None:
        if status > 0:
            # Only the last five, since an FMU may log in every one of a million steps.
            self.messages = [*self.messages[-4:], message.decode("utf-8", "replace").strip()]

    def _words(self) -> str:
        return f"; it says: {self.messages[-1]}" if self.messages else ""

    def __enter__(self) -> Instance:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # errors at its end have no effect on the results
        if error is None:
            with contextlib.suppress(Exception):
                self.fmu.terminate()
        with contextlib.suppress(Exception):
            self.fmu.freeInstance()

    def _call(self, what: str, function: Any, *arguments: Any, **named: Any) -> Any:
        """Call a function of the FMU; raise FmuError with the FMU's last message if it fails."""
        # otherwise an error could quote a message of an earlier call, which does not explain it
        self.messages = []
        try:
            return function(*arguments, **named)
        except Exception as error:  # FMPy's own, and what ctypes makes of a crash
            status = getattr(error, "status", None)
            how = _STATUS.get(status, f"failed: {error}") if isinstance(status, int) else f"failed: {error}"
            raise FmuError(f"{self.archive.name}: {what}: the FMU {how}{self._words()}") from None

    def begin(self, values: Sequence[tuple[Port, float]], parameters: Mapping[str, float]) -> None:
        """Set start values, by port in SI units and by name in the FMU's units, and initialize the FMU at t = 0.

        Raises FmuError for an unknown name or a value that the FMU refuses.
        """
        variables = {variable.name: variable for variable in self.archive.description.modelVariables}
        if not self.archive.three:
            # FMI 2 expects the start time before the initialization, FMI 3 with it.
            self._call("setup", self.fmu.setupExperiment, startTime=0.0)
        for name, value in parameters.items():
            if name not in variables:
                raise FmuError(f"{self.archive.name}: has no variable '{name}'{nearest(name, list(variables))}")
            setter = _SETTERS.get(variables[name].type)
            if setter is None:
                raise FmuError(
                    f"{self.archive.name}: '{name}' is of type {variables[name].type}, which is not a number"
                )
            number = float(value) if "Real" in setter or "Float" in setter else int(value)
            setting = Text(f"{name} = {Quantity(value):6}")
            self._call(setting, getattr(self.fmu, setter), [variables[name].valueReference], [number])
        self.give(values)
        self._call("initialization", self.fmu.enterInitializationMode)
        self._call("initialization", self.fmu.exitInitializationMode)

    def give(self, values: Sequence[tuple[Port, float]]) -> None:
        """Set the inputs, in SI units."""
        if values:
            setter = self.fmu.setFloat64 if self.archive.three else self.fmu.setReal
            self._call(
                "inputs",
                setter,
                [port.reference for port, _ in values],
                [value / port.factor for port, value in values],
            )

    def take(self, ports: Sequence[Port]) -> list[float]:
        """Return the outputs, in SI units."""
        getter = self.fmu.getFloat64 if self.archive.three else self.fmu.getReal
        values = self._call("outputs", getter, [port.reference for port in ports])
        return [port.factor * value for port, value in zip(ports, values, strict=True)]

    def step(self, time: float, length: float) -> None:
        """Perform a communication step, times in s; raise FmuError if the FMU refuses it or ends the simulation."""
        what = Text(f"step of {Quantity(length, 's'):6 SI} at {Quantity(time, 's'):6 SI}")
        answer = self._call(what, self.fmu.doStep, currentCommunicationPoint=time, communicationStepSize=length)
        if answer is not None and (answer[1] or answer[2]):  # terminateSimulation, earlyReturn
            raise FmuError(f"{self.archive.name}: {what}: the FMU wants to end{self._words()}")


def simulate_with_fmu(
    loop: Loop,
    fmu: str | Path,
    reference: Reference,
    *,
    names: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    load: Load | None = None,
    enable: np.ndarray | None = None,
    duration: float | None = None,
    dead_time: float = 0.0,
    bound: float | None = None,
    name: str = "run",
) -> Run:
    """Simulate a controller with an FMU (FMI 2.0 or 3.0, co-simulation) as its plant, along a reference.

        at kT:  reading = outputs of the FMU;  force = control(setpoint, reading), acting from kT + dead_time onward

    This is the order of `simulate`: with the exported plant of the same machine the results are bit-identical.  The
    controller starts disabled, at the first reading, with the axis at rest.

    loop        the controller and its sample time; of the axis only the motor and the number of encoders are used
    fmu         the FMU, **a program**: it runs with all privileges of this process
    names       variables of the FMU by signal, as {"force": "F_drive", "reading": "x:mm"}; a variable that has the name
                of a signal needs no entry.  Inputs are force (or command, in the unit of the drive), load_force and
                start_position; outputs are reading or reading_motor and reading_load, and further signals to record
    parameters  values of the FMU's parameters, by its names and in its units
    load        force on the table, N; the FMU needs an input for it
    enable      1 or 0 for each sample; the last value is held
    dead_time   time before a command acts, s; a fraction of a sample requires an FMU with variable communication step
    bound       bound of |set position - reading|, m; default: the larger of 1 m and 100 times the travel

    Raises FmuError for an FMU that cannot be run, lacks a variable or refuses a step, DivergedError with the
    sample at which the bound was exceeded, and ParameterError for invalid arguments.
    """
    if not 0.0 <= dead_time < 1.0:
        raise ParameterError(f"dead_time = {Quantity(dead_time, 's'):6 SI} must be >= 0 s and < 1 s")
    T = float(loop.sample_time)
    routine = controller_routine(loop, "control")
    motor = loop.axis.actuator.motor
    work = Work(loop, reference, load)
    count = sample_count(work, duration)
    setpoints = work.sampled(0, count)
    rows = np.array([setpoints[name] for name in (*SETPOINT, "load_force")])
    on = np.ones(1) if enable is None else np.asarray(enable, dtype=float)
    # far outside of any loop that works, yet soon enough that a wrong sign does not end in infinities
    limit = max(1.0, 100.0 * float(np.ptp(rows[0]))) if bound is None else bound
    with opened(fmu) as archive:
        wiring = ports(archive, names or {}, None if motor is None else motor.unit)
        wired = _connections(archive, wiring, routine, load is not None)
        taken, answers = np.empty((count, len(wired.taken))), np.empty((count, len(routine.outputs)))
        with Instance(archive) as plant:
            first = [(port, rows[0, 0]) for port in wiring.values() if port.signal == "start_position"]
            plant.begin([*first, *((port, rows[-1, 0]) for port in wired.load)], parameters or {})
            control, held = None, _DeadTime(T, dead_time)
            for k in range(count):
                taken[k] = plant.take(wired.taken)
                seen = taken[k, wired.readings]
                inputs = np.array([*rows[:-1, k], *seen, on[min(k, on.size - 1)]])
                _check_inside(inputs[0] - seen[-1], limit, k, T)
                # Created at the first reading, so that the control starts without a bump where the axis stands.
                control = control or ControllerRun(routine, inputs)
                answers[k] = control.step(inputs[None])[0]
                for time, length, acting in held.pieces(k, answers[k, wired.command]):
                    plant.give([(wired.drive, acting), *((port, rows[-1, k]) for port in wired.load)])
                    plant.step(time, length)
    return Run(name, _signals(routine, wired, rows, taken, answers), T, count)


def _signals(
    routine: Routine, wired: _Connections, rows: np.ndarray, taken: np.ndarray, answers: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the recorded signals of a run, with the names and in the order of the loop's signals."""
    signals = dict(zip(("set_position", "set_velocity", "set_acceleration"), rows, strict=False))
    signals |= {port.signal: taken[:, i] for i, port in enumerate(wired.taken)}
    signals["reading_motor"], signals["reading_load"] = (taken[:, wired.readings[i]] for i in (0, -1))
    signals |= {v.name: answers[:, i] for i, v in enumerate(routine.outputs)} | {"load_force": rows[-1]}
    signals["following_error"] = signals["set_position"] - signals["reading_load"]
    if "position_load" in signals:
        signals["tracking_error"] = signals["set_position"] - signals["position_load"]
    return {signal: signals[signal] for signal in Signals._fields if signal in signals}


class _Connections(NamedTuple):
    """The wiring: FMU outputs, their indices for the controller's readings, the controller output for the drive, and
    any load.
    """

    taken: list[Port]
    readings: list[int]
    command: int
    drive: Port
    load: list[Port]


def _connections(archive: Archive, wiring: Mapping[str, Port], routine: Routine, load: bool) -> _Connections:
    """Connect controller and FMU; an FMU output `reading` replaces a missing reading of either encoder, and
    `reading_load` replaces a missing `reading`.

    Raises FmuError if the controller needs a signal for which there is no variable.
    """
    readings = [v.name for v in routine.inputs if v.name.startswith("reading")]
    spare = "reading_load" if readings == ["reading"] else "reading"
    readings = [spare if reading not in wiring and spare in wiring else reading for reading in readings]
    command = "command" if "command" in wiring else "force"
    needed(wiring, [*readings, command], archive, "the control")
    needed(wiring, ["load_force"] if load else [], archive, "the load")
    taken = [port for signal, port in wiring.items() if signal in TAKEN]
    return _Connections(
        taken=taken,
        readings=[[port.signal for port in taken].index(signal) for signal in readings],
        command=[v.name for v in routine.outputs].index(command),
        drive=wiring[command],
        load=[wiring["load_force"]] if load else [],
    )


class _DeadTime:
    """The commands delayed by the dead time: whole samples in a queue, a fraction of a sample as a separate step."""

    def __init__(self, T: float, dead_time: float) -> None:
        # 3e-4 / 1e-4 is 2.9999999999999996 in doubles: without the margin a whole number of samples would be split.
        whole = math.floor(dead_time / T + 1e-9)
        part = dead_time - whole * T
        # A remainder within rounding would be a step of almost no length, which solvers refuse.
        self.T, self.part = T, part if part > 1e-9 * T else 0.0
        self.pending = [0.0] * (whole + (self.part > 0.0))

    def pieces(self, k: int, command: float) -> list[tuple[float, float, float]]:
        """Return the time, length and acting command of the communication steps of sample k."""
        commands = [command, *self.pending]
        self.pending = commands[:-1]
        start = k * self.T
        if self.part == 0.0:
            return [(start, self.T, commands[-1])]
        return [(start, self.part, commands[-1]), (start + self.part, self.T - self.part, commands[-2])]


def _check_inside(error: float, limit: float, k: int, T: float) -> None:
    if not abs(error) <= limit:
        raise DivergedError(
            f"the loop left its bounds at sample {k} (t = {Quantity(k * T, 's'):6 SI}): |set position - reading| is "
            f"{Quantity(abs(error), 'm'):SI}, not <= {Quantity(limit, 'm'):6 SI}; check sign and unit of the FMU's "
            "force and position, then the gains"
        )


MOST = 500_000_000  # bytes of an FMU


class Row(NamedTuple):
    """The name of a law and its run."""

    name: str
    run: Run

    def figures(self) -> dict[str, float]:
        """Return the error and force figures in SI units, and the code of the first trip (0: none)."""
        error, force, trip = self.run["following_error"], self.run["force"], self.run["trip"]
        return {
            "following_error_rms_m": float(np.sqrt(np.mean(error * error))),
            "following_error_peak_m": float(np.max(np.abs(error))),
            "force_peak_N": float(np.max(np.abs(force))),
            "trip": float(next(iter(trip[trip > 0.0]), 0.0)),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Cosimulation(Result):
    """The runs of all laws of a job with one FMU as the plant; `digest` is the SHA-256 of the FMU's file."""

    job: Job
    fmu: str
    digest: str
    rows: tuple[Row, ...]

    def table(self) -> Table:
        """Return a table of following error, force and trip by law."""
        lines: list[list[str | float | int]] = []
        for row in self.rows:
            rms, peak, force, trip = row.figures().values()
            lines.append([row.name, rms, peak, force, int(trip)])
        columns = ["law", Column("RMS", "m"), Column("peak", "m"), Column("force", "N"), "trip"]
        return Table(f"{self.job.title}, against {Path(self.fmu).name}", columns, lines)


def cosimulate(
    job: Job,
    fmu: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    dead_time: float = 0.0,
    progress: Progress | None = None,
) -> Cosimulation:
    """Run all laws of a job with an FMU as the plant; the FMU is a program that runs in this process.

    names, parameters, dead_time as for `simulate_with_fmu`; `progress` reports the name of each law before its run.

    Raises ParameterError for a job that replays a log or couples several axes, and the errors of `simulate_with_fmu`.
    """
    if job.reference is None:
        raise ParameterError(
            f"{job.file.name}: replays a log, which is valid only for its own plant: give a [reference]"
        )
    if job.machines:
        raise ParameterError(
            f"{job.file.name}: runs several axes together, which an FMU of one plant cannot be: take a job without "
            f"[others] on a machine file without [[couplings]]"
        )
    digest = digest_of(read_whole(fmu, MOST))
    rows = []
    for name, loop in job.loops.items():
        if progress is not None:
            progress.step(name)
        try:
            run = simulate_with_fmu(
                loop,
                fmu,
                job.reference,
                names=names,
                parameters=parameters,
                load=job.load,
                duration=job.duration,
                dead_time=dead_time,
                name=name,
            )
        except FeeddriveError as error:
            raise type(error)(f"{job.file.name}: law '{name}': {error}") from None
        rows.append(Row(name, run))
    return Cosimulation(job, str(fmu), digest, tuple(rows))


def write_cosimulation(result: Cosimulation, out: str | Path) -> Path:
    """Write summary.json, the signals as runs/LAW.parquet and .csv, and copies of the job and machine files; return the
    path of the summary.

    Raises FileError as `new_directory` does.
    """
    with new_directory(out) as folder:
        (folder / "summary.json").write_text(json.dumps(_summary(result), indent=2) + "\n", encoding="utf-8")
        (folder / "job.toml").write_text(result.job.file.text, encoding="utf-8")
        (folder / "machine.toml").write_text(result.job.machine.file.text, encoding="utf-8")
        (folder / "runs").mkdir()
        for file, (name, run) in zip(file_names(result.rows), result.rows, strict=True):
            metadata = {"law": name, "fmu": result.digest, **versions()}
            path = folder / "runs" / file
            write_run_parquet(f"{path}.parquet", run.time, run.signals, run.units, run.sample_time, metadata)
            write_run_csv(f"{path}.csv", run.time, run.signals, run.units)
    return Path(out) / "summary.json"


def _summary(result: Cosimulation) -> dict[str, Any]:
    return {
        "title": result.job.title,
        "machine": result.job.machine.name,
        "fmu": {"file": result.fmu, "sha256": result.digest},
        "versions": dict(versions()),
        "laws": {row.name: row.figures() for row in result.rows},
    }
