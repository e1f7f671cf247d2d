"""An imported FMU: unpacking, checks, mapping of its variables to signals of the loop, stepping, closing.

An FMU is executable code: see `opened`.  The units of its variables are converted to SI.
"""

from __future__ import annotations

import contextlib
import ctypes
import tempfile
import zipfile
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from feeddrive.files.atomic_io import refusal
from feeddrive.language.errors import FmuError, MissingExtraError, ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.language.units import factor, measure
from feeddrive.loop.loop import UNITS

MOST = 2_000_000_000  # bytes that are unpacked


@dataclass(frozen=True)
class Archive:
    """An unpacked FMU: its file, its description as FMPy reads it, its folder, and its library for this machine."""

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
    """Unpack an FMU for the duration of the block; none of its code is run yet.

    Raises FileError for a file that cannot be read, FmuError for a file that is not an FMU, has no co-simulation or
    no binary for this machine, and MissingExtraError without FMPy.
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
        except Exception as error:  # a ZIP or an XML file can be broken in ways that only their readers know
            raise FmuError(f"{path}: is damaged or not an FMU: {_first_line(error)}") from None
        yield _checked(str(path), description, Path(folder))


def importer() -> Any:
    """Return FMPy. Raises MissingExtraError without it."""
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
    if size > MOST:
        raise FmuError(
            f"{path}: would take {Quantity(size / 1e9, 'GB'):3} unpacked, more than the {Quantity(MOST / 1e9, 'GB')} "
            "that are read"
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
    """A variable that carries a signal: value in SI = factor · value of the FMU."""

    signal: str
    variable: str
    reference: int
    factor: float


def ports(archive: Archive, names: Mapping[str, str], command_unit: str | None) -> dict[str, Port]:
    """Return the ports by signal: those given in `names`, and all signals that the FMU has under their own name.

    `names` are the FMU's variables by signal, as "x" or "x:mm"; a variable without a unit counts as SI.
    `command_unit` is the unit of the drive's command; None without a motor.

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
    """Return the conversion factor from the unit given by the caller, else from the unit stated in the FMU."""
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
    """An instance of an FMU for co-simulation; use it in a `with` block.

    Code of the FMU runs in this process, with its rights. Messages of the FMU are kept and repeated in errors.
    """

    def __init__(self, archive: Archive) -> None:
        """Load its library and instantiate it. Raises FmuError if either fails."""
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
        """Return the callbacks of FMI 2, with a logger that takes a variable number of arguments."""
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
        """Call the FMU. Raises FmuError with its last message."""
        # a message of an earlier call would be quoted for an error that it does not explain
        self.messages = []
        try:
            return function(*arguments, **named)
        except Exception as error:  # FMPy's own, and what ctypes makes of a crash
            status = getattr(error, "status", None)
            how = _STATUS.get(status, f"failed: {error}") if isinstance(status, int) else f"failed: {error}"
            raise FmuError(f"{self.archive.name}: {what}: the FMU {how}{self._words()}") from None

    def begin(self, values: Sequence[tuple[Port, float]], parameters: Mapping[str, float]) -> None:
        """Set start values, by port in SI and by name in the FMU's units, and initialize at t = 0.

        Raises FmuError for an unknown name and for a value that the FMU refuses.
        """
        variables = {variable.name: variable for variable in self.archive.description.modelVariables}
        if not self.archive.three:
            # FMI 2 takes the start time before the initialization, FMI 3 with it.
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
        """Set the inputs, in SI."""
        if values:
            setter = self.fmu.setFloat64 if self.archive.three else self.fmu.setReal
            self._call(
                "inputs",
                setter,
                [port.reference for port, _ in values],
                [value / port.factor for port, value in values],
            )

    def take(self, ports: Sequence[Port]) -> list[float]:
        """Return the outputs, in SI."""
        getter = self.fmu.getFloat64 if self.archive.three else self.fmu.getReal
        values = self._call("outputs", getter, [port.reference for port in ports])
        return [port.factor * value for port, value in zip(ports, values, strict=True)]

    def step(self, time: float, length: float) -> None:
        """Perform a communication step, times in s. Raises FmuError if it is refused or the FMU ends the simulation."""
        what = Text(f"step of {Quantity(length, 's'):6 SI} at {Quantity(time, 's'):6 SI}")
        answer = self._call(what, self.fmu.doStep, currentCommunicationPoint=time, communicationStepSize=length)
        if answer is not None and (answer[1] or answer[2]):  # terminateSimulation, earlyReturn
            raise FmuError(f"{self.archive.name}: {what}: the FMU wants to end{self._words()}")
