"""An FMU that is not ours: a mass with viscous friction in mm and kN, written by hand, exact for a force that is held.

v' = (F - b v)/m.  It takes any step, its variables stand in another order and under other names, its inputs are
continuous, and it knows neither states nor derivatives.
"""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import feeddrive
from feeddrive.export.c_bundle import compiler

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="slide" guid="{a-foreign-guid}" variableNamingConvention="structured">
  <CoSimulation modelIdentifier="slide" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions>
    <Unit name="mm"><BaseUnit m="1" factor="1e-3"/></Unit>
    <Unit name="kN"><BaseUnit m="1" kg="1" s="-2" factor="1e3"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="table.x" valueReference="70" causality="output"><Real unit="mm"/></ScalarVariable>
    <ScalarVariable name="table.v" valueReference="71" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="count" valueReference="5" causality="output" variability="discrete"
      ><Integer/></ScalarVariable>
    <ScalarVariable name="motor.F" valueReference="12" causality="input"><Real unit="kN" start="0"/></ScalarVariable>
    <ScalarVariable name="heat" valueReference="13" causality="output"><Real unit="degC"/></ScalarVariable>
    <ScalarVariable name="m" valueReference="1" causality="parameter" variability="fixed">
      <Real start="100"/>
    </ScalarVariable>
    <ScalarVariable name="b" valueReference="2" causality="parameter" variability="fixed">
      <Real start="500"/>
    </ScalarVariable>
    <ScalarVariable name="broken_after" valueReference="3" causality="parameter" variability="fixed">
      <Real start="1e9"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="1"/><Unknown index="2"/><Unknown index="3"/><Unknown index="5"/></Outputs>
    <InitialUnknowns><Unknown index="1"/><Unknown index="2"/><Unknown index="3"/><Unknown index="5"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

SOURCE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
struct slide { double value[100]; fmi2CallbackFunctions calls; };
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f,
                              fmi2Boolean v, fmi2Boolean l)
{
    struct slide *s = calloc(1, sizeof *s);
    if (strcmp(g, "{a-foreign-guid}") != 0) return NULL;
    s->value[1] = 100.0; s->value[2] = 500.0; s->value[3] = 1e9; s->calls = *f;
    return s;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[])
{
    struct slide *s = c;
    for (size_t i = 0; i < n; i++) x[i] = s->value[vr[i]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real x[])
{
    struct slide *s = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == 1 && !(x[i] > 0.0)) {
            s->calls.logger(s->calls.componentEnvironment, "slide", fmi2Error, "error", "a mass of %g kg", x[i]);
            return fmi2Error;
        }
        s->value[vr[i]] = x[i];
    }
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no)
{
    struct slide *s = c;
    double b = s->value[2], m = s->value[1], F = 1e3 * s->value[12], v = s->value[71], share = -expm1(-b * h / m);
    if (t >= s->value[3]) {
        s->calls.logger(s->calls.componentEnvironment, "slide", fmi2Error, "error", "the belt is broken");
        return fmi2Error;
    }
    s->value[70] += 1e3 * (F / b * h + (v - F / b) * m / b * share);
    s->value[71] = v + (F / b - v) * share;
    return fmi2OK;
}
#define YES(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2OK; }
#define NO(name, ...) fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
#define ALONE(name) fmi2Status name(fmi2Component c) { return fmi2OK; }
#define VR const fmi2ValueReference vr[], size_t n
YES(fmi2SetDebugLogging, fmi2Boolean l, size_t n, const fmi2String x[])
YES(fmi2SetupExperiment, fmi2Boolean d, fmi2Real e, fmi2Real s, fmi2Boolean f, fmi2Real t)
ALONE(fmi2EnterInitializationMode) ALONE(fmi2ExitInitializationMode) ALONE(fmi2Terminate) ALONE(fmi2Reset)
NO(fmi2GetInteger, VR, fmi2Integer x[]) NO(fmi2GetBoolean, VR, fmi2Boolean x[]) NO(fmi2GetString, VR, fmi2String x[])
NO(fmi2SetInteger, VR, const fmi2Integer x[]) NO(fmi2SetBoolean, VR, const fmi2Boolean x[])
NO(fmi2SetString, VR, const fmi2String x[]) NO(fmi2GetFMUstate, fmi2FMUstate *s) NO(fmi2SetFMUstate, fmi2FMUstate s)
NO(fmi2FreeFMUstate, fmi2FMUstate *s) NO(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
NO(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte x[], size_t n)
NO(fmi2DeSerializeFMUstate, const fmi2Byte x[], size_t n, fmi2FMUstate *s)
NO(fmi2GetDirectionalDerivative, const fmi2ValueReference u[], size_t n, const fmi2ValueReference k[], size_t m,
   const fmi2Real x[], fmi2Real y[])
NO(fmi2SetRealInputDerivatives, VR, const fmi2Integer o[], const fmi2Real x[])
NO(fmi2GetRealOutputDerivatives, VR, const fmi2Integer o[], fmi2Real x[])
ALONE(fmi2CancelStep)
NO(fmi2GetStatus, const fmi2StatusKind k, fmi2Status *x) NO(fmi2GetRealStatus, const fmi2StatusKind k, fmi2Real *x)
NO(fmi2GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *x)
NO(fmi2GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *x)
NO(fmi2GetStringStatus, const fmi2StatusKind k, fmi2String *x)
"""


def slide(folder: Path, *, description: str = DESCRIPTION, place: str | None = None) -> Path:
    """The FMU as a file; `place` is the folder of its binary, by default the one of this machine."""
    import fmpy

    headers = Path(feeddrive.__file__).parent / "export" / "fmi" / "headers"
    source, library = folder / "slide.c", folder / "slide.so"
    if not library.exists():
        source.write_text(SOURCE, encoding="utf-8")
        words = [*compiler(), "-shared", "-fPIC", "-I", str(headers), "-o", str(library), str(source), "-lm"]
        subprocess.run(words, check=True)
    path = folder / "slide.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{place or fmpy.platform}/slide{fmpy.sharedLibraryExtension}")
    return path


def damaged(fmu: Path, path: Path, **entries: bytes | None) -> Path:
    """A copy of an FMU with other content of some files, by name; None leaves one out."""
    shutil.copy(fmu, path)
    with zipfile.ZipFile(fmu) as archive:
        content = {name: archive.read(name) for name in archive.namelist()} | entries
    with zipfile.ZipFile(path, "w") as archive:
        for name, each in content.items():
            if each is not None:
                archive.writestr(name, each)
    return path
