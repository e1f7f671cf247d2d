/* FMI 2.0 for co-simulation around the exported C. */
#include "fmi2Functions.h"
/* A step that is refused is an error here: importers ask for ever again what FMI 2 discards. */
#define REFUSED ERROR
#define FMI(name) fmi2##name
#define HANDLE fmi2Component
#define STATE fmi2FMUstate
#define GET_STATE fmi2GetFMUstate
#define SET_STATE fmi2SetFMUstate
#define FREE_STATE fmi2FreeFMUstate
#define STATE_SIZE fmi2SerializedFMUstateSize
#define SERIALIZE fmi2SerializeFMUstate
#define DESERIALIZE fmi2DeSerializeFMUstate
#define VALUE_COUNT
#define AS_MANY 1
#include "fmu_functions.h"

static void deliver(const instance *one, int status, const char *category, const char *text)
{
    const fmi2CallbackFunctions *callbacks = one->callback;
    if (callbacks->logger != NULL) {
        callbacks->logger(callbacks->componentEnvironment, one->name, (fmi2Status)status, category, "%s", text);
    }
}

/* ---- the model's life ---- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    instance *one = NULL;
    const char *why = "no memory for an instance";
    (void)resources;
    (void)visible;
    if (type != fmi2CoSimulation) {
        why = "this FMU is for co-simulation only";
    } else if (name == NULL || name[0] == '\0') {
        why = "an instance needs a name";
    } else if (guid == NULL || strcmp(guid, MODEL_TOKEN) != 0) {
        why = "the GUID is not that of this FMU: modelDescription.xml and binary do not belong together";
    } else {
        one = make(name, guid, logging);
    }
    if (one == NULL) {
        if (callbacks != NULL && callbacks->logger != NULL) {
            callbacks->logger(callbacks->componentEnvironment, name == NULL ? "" : name, fmi2Error, "logStatusError",
                              "%s", why);
        }
        return NULL;
    }
    one->callback = callbacks;
    return one;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stopDefined, fmi2Real stop)
{
    instance *one = c;
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopDefined;
    (void)stop;
    REQUIRE(INSTANTIATED);
    one->now.time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    instance *one = c;
    REQUIRE(INSTANTIATED);
    one->now.mode = INITIALIZING;
    return fmi2OK;
}

/* ---- variables ---- */

GETTER(fmi2GetReal, fmi2Real, NUMBER)
GETTER(fmi2GetInteger, fmi2Integer, ENUMERATION)
GETTER(fmi2GetBoolean, fmi2Boolean, TRUTH)
SETTER(fmi2SetReal, fmi2Real, NUMBER)
SETTER(fmi2SetInteger, fmi2Integer, ENUMERATION)
SETTER(fmi2SetBoolean, fmi2Boolean, TRUTH)

/* ---- one step ---- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(STEPPING);
    return (fmi2Status)advance(c, time, step);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind;
    (void)value;
    REQUIRE(ALIVE);
    return (fmi2Status)tell(c, DISCARD, "logStatusDiscard", "no step runs beside others: there is no such status");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    instance *one = c;
    REQUIRE(ALIVE);
    if (kind != fmi2LastSuccessfulTime) {
        return (fmi2Status)tell(c, DISCARD, "logStatusDiscard", "there is no such status");
    }
    *value = one->now.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    REQUIRE(ALIVE);
    if (kind != fmi2Terminated) {
        return (fmi2Status)tell(c, DISCARD, "logStatusDiscard", "there is no such status");
    }
    *value = fmi2False; /* the model never asks to end the simulation */
    return fmi2OK;
}

/* ---- what FMI 2 has and this model has not; modelDescription.xml says so ---- */

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

ABSENT(fmi2GetString, const fmi2ValueReference vr[], size_t count, fmi2String value[])
ABSENT(fmi2SetString, const fmi2ValueReference vr[], size_t count, const fmi2String value[])
ABSENT(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t unknowns,
       const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[], fmi2Real value[])
ABSENT(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[],
       const fmi2Real value[])
ABSENT(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t count, const fmi2Integer order[],
       fmi2Real value[])
ABSENT(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
ABSENT(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)

fmi2Status fmi2CancelStep(fmi2Component c)
{
    REQUIRE(ALIVE);
    return (fmi2Status)tell(c, ERROR, "logStatusError", "fmi2CancelStep: no step runs beside others");
}
