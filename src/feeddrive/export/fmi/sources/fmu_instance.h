/* What FMI 2 and FMI 3 have in common: one instance of the model, its variables, its time, and its states by copy.

   The model itself is the exported C, included whole; `fmu_model.h` is generated and says which variables there are.
   Everything here is static, so that two FMUs in one process share nothing. */
#ifndef FMU_INSTANCE_H
#define FMU_INSTANCE_H

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_model.h"

/* The values are those of fmi2Status and fmi3Status. */
enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 };

enum mode { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8 };

/* What a state of the FMU holds: all that a step reads. Plain data without a pointer, copied whole. */
typedef struct {
    double time;   /* s, where the last step ended */
    int32_t mode;  /* one of enum mode */
    int32_t began; /* 0 before the first step */
    int32_t tuned; /* 1 if a parameter was set since the last step */
    MODEL(parameters) parameters;
    MODEL(inputs) inputs;
    MODEL(outputs) outputs;
    MODEL_CORE core;
} situation;

typedef struct {
    situation now;
    int logging;
    void *environment; /* of who runs the FMU */
    const void *callback;/* where messages go; of a type that fmi2.c or fmi3.c knows */
    char *name;
} instance;

/* A message handed to the callback, which is there; `fmi2.c` and `fmi3.c` know how. */
static void deliver(const instance *one, int status, const char *category, const char *text);

/* A message with a status and a category, to whoever runs the FMU; gives the status back. */
static int tell(const instance *one, int status, const char *category, const char *form, ...)
{
    if (one->logging && one->callback != NULL) {
        char text[400];
        va_list values;
        va_start(values, form);
        vsnprintf(text, sizeof text, form, values);
        va_end(values);
        deliver(one, status, category, text);
    }
    return status;
}

/* ---- one instance ---- */

static void begin(instance *one)
{
    memset(&one->now, 0, sizeof one->now);
    MODEL(defaults)(&one->now.parameters);
    one->now.mode = INSTANTIATED;
}

static instance *make(const char *name, const char *token, int logging)
{
    instance *one;
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        return NULL;
    }
    one = calloc(1, sizeof *one);
    if (one == NULL) {
        return NULL;
    }
    one->name = malloc(strlen(name) + 1);
    if (one->name == NULL) {
        free(one);
        return NULL;
    }
    strcpy(one->name, name);
    one->logging = logging;
    begin(one);
    return one;
}

static void unmake(instance *one)
{
    if (one != NULL) {
        free(one->name);
        free(one);
    }
}

static int allowed(const instance *one, int modes, const char *function)
{
    if (one == NULL) {
        return 0;
    }
    if ((one->now.mode & modes) == 0) {
        tell(one, ERROR, "logStatusError", "%s: cannot be called in this mode", function);
        return 0;
    }
    return 1;
}

/* ---- variables ---- */

static double *place(situation *now, const struct variable *variable)
{
    char *part = variable->group == PARAMETER ? (char *)&now->parameters
                 : variable->group == OUTPUT  ? (char *)&now->outputs
                                              : (char *)&now->inputs;
    return (double *)(void *)(part + variable->offset);
}

static const struct variable *found(const instance *one, unsigned int reference, enum kind kind)
{
    if (reference >= VARIABLE_COUNT || VARIABLES[reference].kind != kind) {
        tell(one, ERROR, "logStatusError", "there is no variable of this type with the value reference %u", reference);
        return NULL;
    }
    return &VARIABLES[reference];
}

static int get(instance *one, unsigned int reference, enum kind kind, double *value)
{
    const struct variable *variable = found(one, reference, kind);
    if (variable == NULL) {
        return ERROR;
    }
    if (variable->group == TIME) {
        *value = one->now.time;
    } else if (variable->group == CLOCK) {
        *value = MODEL_SAMPLE_TIME;
    } else {
        *value = *place(&one->now, variable);
    }
    return OK;
}

static int set(instance *one, unsigned int reference, enum kind kind, double value)
{
    const struct variable *variable = found(one, reference, kind);
    const char *why = NULL;
    if (variable == NULL) {
        return ERROR;
    }
    if (variable->group == TIME || variable->group == OUTPUT) {
        why = "is computed: it cannot be set";
    } else if (variable->group == CLOCK) {
        if (value == MODEL_SAMPLE_TIME) {
            return OK;
        }
        why = "is fixed: the control was designed for it; export it anew for another one";
    } else if (variable->group != INPUT && !(value - value == 0.0)) {
        why = "must be a finite number";
    } else if (variable->group != INPUT && !variable->tunable && one->now.mode == STEPPING) {
        why = "is fixed: it can be set before the initialization ends";
    } else if (variable->group == PARAMETER && (value < variable->least || value > variable->most)) {
        why = "is outside its bounds, which modelDescription.xml states";
    }
    if (why != NULL) {
        return tell(one, ERROR, "logStatusError", "%s = %.15g %s", variable->name, value, why);
    }
    *place(&one->now, variable) = value;
    if (variable->group == PARAMETER) {
        one->now.tuned = 1;
    }
    return OK;
}

/* ---- time ---- */

/* Whether the parameters keep the rules of their blocks; says which is broken if they do not. */
static int admitted(const instance *one)
{
    const int rule = MODEL(broken_rule)(&one->now.parameters);
    if (rule < 0) {
        tell(one, ERROR, "logStatusError", "this binary breaks rule %d: %s", rule, model_rule(rule));
    } else if (rule != 0) {
        tell(one, ERROR, "logStatusError", "the parameters break rule %d: %s", rule, model_rule(rule));
    }
    return rule == 0;
}

static int initialize(instance *one)
{
    if (!admitted(one)) {
        return ERROR;
    }
    one->now.tuned = 0;
    MODEL(configure)(&one->now.core, &one->now.parameters);
    model_first(&one->now.core, &one->now.inputs, &one->now.outputs);
    one->now.began = 0;
    one->now.mode = STEPPING;
    return OK;
}

static void tell_trip(const instance *one, double time, int loop, int before, int after)
{
    if (after != before && after != 0) {
        tell(one, WARNING, "logEvents", "%stripped at %.9g s: %s (trip = %d); no force until enable is taken away",
             LOOPS[loop], time, model_trip_name(after), after);
    } else if (after != before) {
        tell(one, OK, "logEvents", "%strip cleared at %.9g s", LOOPS[loop], time);
    }
}

/* From `time` on over `step`, a whole multiple of the sample time; inputs are held. */
static int advance(instance *one, double time, double step)
{
    const double T = MODEL_SAMPLE_TIME;
    const double count = floor(step / T + 0.5);
    situation *now = &one->now;
    double k;
    if (!(count >= 1.0 && count <= 1e9 && fabs(step - count * T) <= 1e-3 * T)) {
        return tell(one, REFUSED, REFUSED == ERROR ? "logStatusError" : "logStatusDiscard",
                    "a communication step of %.15g s is no whole multiple of the sample time, %.15g s", step, T);
    }
    if (!(fabs(time - now->time) <= 1e-3 * T + 1e-15 * fabs(time))) {
        return tell(one, ERROR, "logStatusError", "a step from %.15g s on, but the last one ended at %.15g s", time,
                    now->time);
    }
    if (now->tuned && !admitted(one)) {
        now->parameters = now->core.parameters; /* the old ones go on */
        now->tuned = 0;
        return ERROR;
    }
    if (!now->began) {
        if (now->tuned) {
            MODEL(configure)(&now->core, &now->parameters);
        }
        model_start(&now->core, &now->inputs);
    } else if (now->tuned) {
        model_tune(&now->core, &now->parameters);
    }
    now->began = 1;
    now->tuned = 0;
    for (k = 0.0; k < count; k += 1.0) {
        int before[LOOP_COUNT], loop;
        for (loop = 0; loop < LOOP_COUNT; loop++) {
            before[loop] = model_trip(&now->outputs, loop);
        }
        const uint64_t mode = MODEL(flush_begin)();
        MODEL(step)(&now->core, &now->inputs, &now->outputs);
        MODEL(flush_end)(mode);
        for (loop = 0; loop < LOOP_COUNT; loop++) {
            tell_trip(one, time + k * T, loop, before[loop], model_trip(&now->outputs, loop));
        }
    }
    now->time = time + step;
    return OK;
}

/* ---- states, by copy ---- */

static int keep(const instance *one, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(situation));
    }
    if (*state == NULL) {
        return tell(one, ERROR, "logStatusError", "no memory for a state");
    }
    memcpy(*state, &one->now, sizeof(situation));
    return OK;
}

static int restore(instance *one, const void *state)
{
    if (state == NULL) {
        return tell(one, ERROR, "logStatusError", "no state was given");
    }
    memcpy(&one->now, state, sizeof(situation));
    return OK;
}

static void drop(void **state)
{
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
}

/* A state as bytes: the token of the FMU first, so that another FMU refuses it. They hold for the same binary. */
enum { TOKEN_SIZE = sizeof MODEL_TOKEN };
static const size_t SERIALIZED = TOKEN_SIZE + sizeof(situation);

static int serialize(const instance *one, const void *state, void *bytes, size_t size)
{
    if (state == NULL || bytes == NULL || size < SERIALIZED) {
        return tell(one, ERROR, "logStatusError", "a state has %lu bytes, but room was given for %lu",
                    (unsigned long)SERIALIZED, (unsigned long)size);
    }
    memcpy(bytes, MODEL_TOKEN, TOKEN_SIZE);
    memcpy((char *)bytes + TOKEN_SIZE, state, sizeof(situation));
    return OK;
}

static int deserialize(const instance *one, const void *bytes, size_t size, void **state)
{
    if (bytes == NULL || size < SERIALIZED || memcmp(bytes, MODEL_TOKEN, TOKEN_SIZE) != 0) {
        return tell(one, ERROR, "logStatusError", "the bytes are no state of this FMU");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(situation));
    }
    if (*state == NULL) {
        return tell(one, ERROR, "logStatusError", "no memory for a state");
    }
    memcpy(*state, (const char *)bytes + TOKEN_SIZE, sizeof(situation));
    return OK;
}

#endif
