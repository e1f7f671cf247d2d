"""FMUs through FMPy's own functions, one call at a time: an importer that shares nothing with feeddrive."""

from __future__ import annotations

import ctypes
from pathlib import Path

import fmpy
import fmpy.fmi2
import fmpy.fmi3
import numpy as np
from fmpy.logging import addLoggerProxy


class Played:
    """An instance of an FMU of version 2 or 3 between FMI calls."""

    def __init__(self, path: Path, folder: Path, *, token: str | None = None, name: str = "one", **start: float):
        self.description = fmpy.read_model_description(str(path))
        self.three = self.description.fmiVersion == "3.0"
        self.references = {each.name: each.valueReference for each in self.description.modelVariables}
        self.kinds = {each.name: each.type for each in self.description.modelVariables}
        self.said: list[tuple[int, str, str]] = []
        unzipped = folder / path.name.replace(".", "_")
        if not unzipped.exists():
            fmpy.extract(str(path), str(unzipped))
        model = self.description.coSimulation.modelIdentifier
        place = fmpy.platform_tuple if self.three else fmpy.platform
        library = unzipped / "binaries" / place / f"{model}{fmpy.sharedLibraryExtension}"
        kind = fmpy.fmi3.FMU3Slave if self.three else fmpy.fmi2.FMU2Slave
        self.fmu = kind(
            guid=token or self.description.guid,
            modelIdentifier=model,
            unzipDirectory=str(unzipped),
            instanceName=name,
            libraryPath=str(library),
        )
        self._instantiate()
        self.begin(**start)

    def _instantiate(self) -> None:
        if self.three:
            self.fmu.instantiate(loggingOn=True, logMessage=lambda _, s, c, m: self._heard(s, c, m))
            return
        self.callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(lambda _, __, s, c, m: self._heard(s, c, m))
        self.callbacks.allocateMemory = fmpy.fmi2.defaultCallbacks.allocateMemory
        self.callbacks.freeMemory = fmpy.fmi2.defaultCallbacks.freeMemory
        addLoggerProxy(ctypes.byref(self.callbacks))
        self.fmu.instantiate(callbacks=self.callbacks, loggingOn=True)

    def _heard(self, status: int, category: bytes, message: bytes) -> None:
        self.said.append((status, category.decode(), message.decode()))

    def begin(self, at: float = 0.0, **start: float) -> None:
        """From instantiated to stepping."""
        if not self.three:
            self.fmu.setupExperiment(startTime=at)
        self.set(**start)
        if self.three:
            self.fmu.enterInitializationMode(startTime=at)
        else:
            self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        for name, value in values.items():
            setter = {
                "Real": "setReal",
                "Float64": "setFloat64",
                "Boolean": "setBoolean",
                "Enumeration": "setInt64" if self.three else "setInteger",
            }[self.kinds[name]]
            given = bool(value > 0.5) if self.kinds[name] == "Boolean" else value
            getattr(self.fmu, setter)([self.references[name]], [given])

    def get(self, *names: str) -> np.ndarray:
        getters = {
            "Real": "getReal",
            "Float64": "getFloat64",
            "Boolean": "getBoolean",
            "Enumeration": "getInt64" if self.three else "getInteger",
        }
        return np.array([float(getattr(self.fmu, getters[self.kinds[n]])([self.references[n]])[0]) for n in names])

    def step(self, time: float, step: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=step)

    def state(self) -> object:
        return self.fmu.getFMUState() if self.three else self.fmu.getFMUstate()

    def restore(self, state: object) -> None:
        (self.fmu.setFMUState if self.three else self.fmu.setFMUstate)(state)

    def drop(self, state: object) -> None:
        (self.fmu.freeFMUState if self.three else self.fmu.freeFMUstate)(state)

    def bytes_of(self, state: object) -> bytes:
        serialize = self.fmu.serializeFMUState if self.three else self.fmu.serializeFMUstate
        return bytes(serialize(state))

    def state_of(self, content: bytes) -> object:
        return (self.fmu.deserializeFMUState if self.three else self.fmu.deSerializeFMUstate)(content)

    def close(self) -> None:
        self.fmu.freeInstance()
