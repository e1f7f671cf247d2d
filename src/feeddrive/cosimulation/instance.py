"""A running FMU: started, given numbers, stepped, and closed whatever happens."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from feeddrive.cosimulation.archive import Archive
from feeddrive.cosimulation.ports import Port
from feeddrive.files.messages import nearest
from feeddrive.language.errors import FmuError

_SETTERS = {"Real": "setReal", "Float64": "setFloat64", "Integer": "setInteger", "Int32": "setInt32",
            "Int64": "setInt64", "Boolean": "setBoolean"}  # fmt: skip
_STATUS = {2: "refused the step (Discard)", 3: "failed (Error)", 4: "is beyond repair (Fatal)"}


class Instance:
    """An instance of an FMU for co-simulation; use it in a `with` block.

    From here on code of the FMU runs in this process, with the rights of this process.  What it says is kept and
    repeated in errors.
    """

    def __init__(self, archive: Archive) -> None:
        """Load its library and instantiate it. Raises FmuError if either fails."""
        self.archive = archive
        self.said: list[str] = []
        import fmpy.fmi2
        import fmpy.fmi3

        kind = fmpy.fmi3.FMU3Slave if archive.three else fmpy.fmi2.FMU2Slave
        try:
            with contextlib.chdir(archive.folder):  # FMPy goes elsewhere and does not come back if it fails
                self.fmu: Any = kind(
                    guid=archive.description.guid, modelIdentifier=archive.model, unzipDirectory=str(archive.folder),
                    instanceName="plant", libraryPath=str(archive.library),
                )  # fmt: skip
            if archive.three:
                self.fmu.instantiate(loggingOn=True, logMessage=self._heard3)
            else:
                self._callbacks = self._logging()
                self.fmu.instantiate(loggingOn=True, callbacks=self._callbacks)
        except Exception as error:  # FMPy raises bare exceptions
            needs = archive.description.coSimulation.needsExecutionTool
            hint = "; it wants the program it was made with to be installed" if needs else ""
            raise FmuError(f"{archive.name}: cannot be started: {error}{self._words()}{hint}") from None

    def _logging(self) -> Any:
        """The callbacks of FMI 2, with a logger that takes a variable number of arguments."""
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
            self.said = [*self.said[-4:], message.decode("utf-8", "replace").strip()]

    def _words(self) -> str:
        return f"; it says: {self.said[-1]}" if self.said else ""

    def __enter__(self) -> Instance:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # what an FMU says at its end, or whether it is there at all, changes nothing any more
        if error is None:
            with contextlib.suppress(Exception):
                self.fmu.terminate()
        with contextlib.suppress(Exception):
            self.fmu.freeInstance()

    def _call(self, what: str, function: Any, *arguments: Any, **named: Any) -> Any:
        """A call to the FMU. Raises FmuError that repeats what it said."""
        self.said = []
        try:
            return function(*arguments, **named)
        except Exception as error:  # FMPy's own, and what ctypes makes of a crash
            status = getattr(error, "status", None)
            how = _STATUS.get(status, f"failed: {error}") if isinstance(status, int) else f"failed: {error}"
            raise FmuError(f"{self.archive.name}: {what}: the FMU {how}{self._words()}") from None

    def begin(self, values: Sequence[tuple[Port, float]], parameters: Mapping[str, float]) -> None:
        """Set what is known at the start, SI by port and as they are by name, and initialise at t = 0.

        Raises FmuError for a name that the FMU has not and for a value that it refuses.
        """
        known = {each.name: each for each in self.archive.description.modelVariables}
        if not self.archive.three:
            self._call("setup", self.fmu.setupExperiment, startTime=0.0)
        for name, value in parameters.items():
            if name not in known:
                raise FmuError(f"{self.archive.name}: has no variable '{name}'{nearest(name, list(known))}")
            setter = _SETTERS.get(known[name].type)
            if setter is None:
                raise FmuError(f"{self.archive.name}: '{name}' is of type {known[name].type}, which is no number")
            number = float(value) if "Real" in setter or "Float" in setter else int(value)
            self._call(f"{name} = {value:g}", getattr(self.fmu, setter), [known[name].valueReference], [number])
        self.give(values)
        self._call("initialization", self.fmu.enterInitializationMode)
        self._call("initialization", self.fmu.exitInitializationMode)

    def give(self, values: Sequence[tuple[Port, float]]) -> None:
        """Set inputs, in SI."""
        if values:
            setter = self.fmu.setFloat64 if self.archive.three else self.fmu.setReal
            self._call(
                "inputs",
                setter,
                [port.reference for port, _ in values],
                [value / port.factor for port, value in values],
            )

    def take(self, ports: Sequence[Port]) -> list[float]:
        """Outputs, in SI."""
        getter = self.fmu.getFloat64 if self.archive.three else self.fmu.getReal
        values = self._call("outputs", getter, [port.reference for port in ports])
        return [port.factor * value for port, value in zip(ports, values, strict=True)]

    def step(self, time: float, length: float) -> None:
        """One communication step, in s. Raises FmuError if it is refused or if the FMU wants to end."""
        what = f"step of {length:.6g} s at {time:.6g} s"
        answer = self._call(what, self.fmu.doStep, currentCommunicationPoint=time, communicationStepSize=length)
        if answer is not None and (answer[1] or answer[2]):  # terminateSimulation, earlyReturn
            raise FmuError(f"{self.archive.name}: {what}: the FMU wants to end{self._words()}")
