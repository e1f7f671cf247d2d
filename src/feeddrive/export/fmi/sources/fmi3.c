/* FMI 3.0 for co-simulation around the exported C. */
#include "fmi3Functions.h"
#define REFUSED DISCARD /* a step that is no whole multiple of the sample time */
#define FMI(name) fmi3##name
#define HANDLE fmi3Instance
#define STATE fmi3FMUState
#define GET_STATE fmi3GetFMUState
#define SET_STATE fmi3SetFMUState
#define FREE_STATE fmi3FreeFMUState
#define STATE_SIZE fmi3SerializedFMUStateSize
#define SERIALIZE fmi3SerializeFMUState
#define DESERIALIZE fmi3DeserializeFMUState
#define VALUE_COUNT , size_t valueCount
#define AS_MANY (valueCount == count)
#include "fmu_functions.h"

/* A function's address through memcpy: ISO C has no cast from `void *` to a function. */
static fmi3LogMessageCallback logger(const void *kept)
{
    fmi3LogMessageCallback function;
    memcpy(&function, &kept, sizeof function);
    return function;
}

static void deliver(const instance *one, int status, const char *category, const char *text)
{
    logger(one->callback)(one->environment, (fmi3Status)status, category, text);
}

/* ---- the model's life ---- */

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference required[], size_t requiredCount,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback message,
                                         fmi3IntermediateUpdateCallback update)
{
    instance *one = NULL;
    const char *why = "no memory for an instance";
    (void)resources;
    (void)visible;
    (void)earlyReturnAllowed;
    (void)required;
    (void)update;
    if (name == NULL || name[0] == '\0') {
        why = "an instance needs a name";
    } else if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        why = "the instantiation token is not that of this FMU: modelDescription.xml and binary do not belong together";
    } else if (eventModeUsed || requiredCount > 0) {
        why = "this FMU has no event mode and no intermediate updates";
    } else {
        one = make(name, token, logging);
    }
    if (one == NULL) {
        if (message != NULL) {
            message(environment, fmi3Error, "logStatusError", why);
        }
        return NULL;
    }
    one->environment = environment;
    memcpy((void *)&one->callback, &message, sizeof message);
    return one;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stopDefined, fmi3Float64 stop)
{
    instance *one = c;
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopDefined;
    (void)stop;
    REQUIRE(INSTANTIATED);
    one->now.time = start;
    one->now.mode = INITIALIZING;
    return fmi3OK;
}

/* ---- variables ---- */

GETTER(fmi3GetFloat64, fmi3Float64, NUMBER)
GETTER(fmi3GetInt64, fmi3Int64, ENUMERATION)
GETTER(fmi3GetBoolean, fmi3Boolean, TRUTH)
SETTER(fmi3SetFloat64, fmi3Float64, NUMBER)
SETTER(fmi3SetInt64, fmi3Int64, ENUMERATION)
SETTER(fmi3SetBoolean, fmi3Boolean, TRUTH)

/* ---- one step ---- */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    instance *one = c;
    int status;
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(STEPPING);
    status = advance(one, time, step);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = one->now.time;
    return (fmi3Status)status;
}

/* ---- what FMI 3 has and this model has not; modelDescription.xml says so ---- */

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define ABSENT_ALONE(name)                                                                                 \
    fmi3Status name(fmi3Instance c)                                                                        \
    {                                                                                                      \
        REQUIRE(ALIVE);                                                                                    \
        return (fmi3Status)tell(c, ERROR, "logStatusError", "%s: this FMU does not provide it", __func__); \
    }
#define REFERENCES const fmi3ValueReference vr[], size_t count
#define ABSENT_TYPE(name)                                                                        \
    ABSENT(fmi3Get##name, REFERENCES, fmi3##name values[], size_t valueCount)                    \
    ABSENT(fmi3Set##name, REFERENCES, const fmi3##name values[], size_t valueCount)

ABSENT_TYPE(Float32)
ABSENT_TYPE(Int8)
ABSENT_TYPE(UInt8)
ABSENT_TYPE(Int16)
ABSENT_TYPE(UInt16)
ABSENT_TYPE(Int32)
ABSENT_TYPE(UInt32)
ABSENT_TYPE(UInt64)
ABSENT_TYPE(String)
ABSENT(fmi3GetBinary, REFERENCES, size_t sizes[], fmi3Binary values[], size_t valueCount)
ABSENT(fmi3SetBinary, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t valueCount)
ABSENT(fmi3GetClock, REFERENCES, fmi3Clock values[])
ABSENT(fmi3SetClock, REFERENCES, const fmi3Clock values[])
ABSENT(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *count)
ABSENT(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[], fmi3ValueReference independents[],
       size_t independentElements[], fmi3DependencyKind kinds[], size_t count)
ABSENT(fmi3GetDirectionalDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t knownCount,
       const fmi3Float64 seed[], size_t seedCount, fmi3Float64 sensitivity[], size_t sensitivityCount)
ABSENT(fmi3GetAdjointDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t knownCount,
       const fmi3Float64 seed[], size_t seedCount, fmi3Float64 sensitivity[], size_t sensitivityCount)
ABSENT_ALONE(fmi3EnterConfigurationMode)
ABSENT_ALONE(fmi3ExitConfigurationMode)
ABSENT_ALONE(fmi3EnterEventMode)
ABSENT_ALONE(fmi3EnterStepMode)
ABSENT_ALONE(fmi3EvaluateDiscreteStates)
ABSENT(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
       fmi3IntervalQualifier qualifiers[])
ABSENT(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
ABSENT(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
ABSENT(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
ABSENT(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
ABSENT(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
ABSENT(fmi3UpdateDiscreteStates, fmi3Boolean *update, fmi3Boolean *end, fmi3Boolean *nominals, fmi3Boolean *values,
       fmi3Boolean *defined, fmi3Float64 *next)
ABSENT(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t valueCount)

/* Of the other two interfaces; an importer may ask for their names. */
ABSENT_ALONE(fmi3EnterContinuousTimeMode)
ABSENT(fmi3CompletedIntegratorStep, fmi3Boolean noSet, fmi3Boolean *eventMode, fmi3Boolean *end)
ABSENT(fmi3SetTime, fmi3Float64 time)
ABSENT(fmi3SetContinuousStates, const fmi3Float64 states[], size_t count)
ABSENT(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t count)
ABSENT(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t count)
ABSENT(fmi3GetContinuousStates, fmi3Float64 states[], size_t count)
ABSENT(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t count)
ABSENT(fmi3GetNumberOfEventIndicators, size_t *count)
ABSENT(fmi3GetNumberOfContinuousStates, size_t *count)
ABSENT(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback message)
{
    if (message != NULL) {
        message(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
    }
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback message,
                                               fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    if (message != NULL) {
        message(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
    }
    return NULL;
}
