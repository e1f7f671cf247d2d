/* Every function of the FMU in every order that a careless importer might choose, under sanitizers. */
#include <stdarg.h>
#include <stdio.h>
#include "fmi2Functions.h"
#include "fmu_model.h"

static int told;

static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String form,
                   ...)
{
    va_list values;
    char text[500];
    (void)e;
    (void)name;
    (void)status;
    (void)category;
    va_start(values, form);
    vsnprintf(text, sizeof text, form, values);
    va_end(values);
    told++;
}

int main(void)
{
    const fmi2CallbackFunctions calls = {logger, NULL, NULL, NULL, NULL};
    const double values[] = {0.0, 1.0, -1.0, 1e300, -1e300, 5e-324, INFINITY, -INFINITY, NAN};
    double x;
    int k, count = 0;
    fmi2Boolean on = fmi2True;
    fmi2Component one = fmi2Instantiate("one", fmi2CoSimulation, MODEL_TOKEN, NULL, &calls, 0, 1);
    fmi2Component silent = fmi2Instantiate("two", fmi2CoSimulation, MODEL_TOKEN, NULL, NULL, 0, 1);
    if (one == NULL || silent == NULL) return 1;
    if (fmi2Instantiate("x", fmi2CoSimulation, "no", NULL, &calls, 0, 1) != NULL) return 2;
    if (fmi2Instantiate("x", fmi2CoSimulation, NULL, NULL, NULL, 0, 1) != NULL) return 3;
    if (fmi2Instantiate(NULL, fmi2CoSimulation, MODEL_TOKEN, NULL, &calls, 0, 1) != NULL) return 4;
    if (fmi2Instantiate("x", fmi2ModelExchange, MODEL_TOKEN, NULL, &calls, 0, 1) != NULL) return 5;
    if (fmi2DoStep(one, 0.0, MODEL_SAMPLE_TIME, 0) != fmi2Error || fmi2DoStep(NULL, 0.0, 1.0, 0) != fmi2Error) return 6;
    fmi2SetupExperiment(one, 0, 0, 0.0, 0, 0);
    if (fmi2EnterInitializationMode(one) != fmi2OK || fmi2ExitInitializationMode(one) != fmi2OK) return 7;
    if (fmi2ExitInitializationMode(one) != fmi2Error) return 8;
    for (k = 0; k < 20000; k++) {
        fmi2ValueReference vr = (fmi2ValueReference)(((unsigned)k * 2654435761u >> 8) % (VARIABLE_COUNT + 3u));
        fmi2FMUstate state = NULL;
        char bytes[20000];
        size_t size = 0;
        x = values[k % 9];
        fmi2SetReal(one, &vr, 1, &x);
        fmi2SetBoolean(one, &vr, 1, &on);
        fmi2GetReal(one, &vr, 1, &x);
        /* parameters that break a rule are refused once; then the old ones go on */
        if (fmi2DoStep(one, k * MODEL_SAMPLE_TIME, MODEL_SAMPLE_TIME, 0) != fmi2OK &&
            fmi2DoStep(one, k * MODEL_SAMPLE_TIME, MODEL_SAMPLE_TIME, 0) != fmi2OK) return 9;
        for (vr = 0; vr < VARIABLE_COUNT; vr++)
            if (VARIABLES[vr].group == OUTPUT && strcmp(VARIABLES[vr].name, "force") == 0)
                if (fmi2GetReal(one, &vr, 1, &x) != fmi2OK || !(x - x == 0.0)) count++;
        if (k % 1000 == 0) {
            fmi2GetFMUstate(one, &state);
            fmi2SerializedFMUstateSize(one, state, &size);
            if (size > sizeof bytes || fmi2SerializeFMUstate(one, state, bytes, size) != fmi2OK) return 10;
            if (fmi2SerializeFMUstate(one, state, bytes, size - 1) != fmi2Error) return 11;
            if (fmi2DeSerializeFMUstate(one, bytes, size - 1, &state) != fmi2Error) return 12;
            if (fmi2DeSerializeFMUstate(one, bytes, size, &state) != fmi2OK) return 13;
            fmi2SetFMUstate(one, state);
            fmi2FreeFMUstate(one, &state);
            fmi2FreeFMUstate(one, &state);
            if (fmi2SetFMUstate(one, state) != fmi2Error) return 14;
        }
    }
    fmi2Terminate(one);
    fmi2Reset(one);
    fmi2FreeInstance(one);
    fmi2FreeInstance(silent);
    fmi2FreeInstance(NULL);
    printf("%d %d\n", told, count);
    return 0;
}
