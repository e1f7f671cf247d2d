/* What FMI 2 and FMI 3 define alike, apart from the names. `fmi2.c` and `fmi3.c` include it after they have defined

   FMI(name)      a name of the standard, with its prefix
   HANDLE, STATE  the types of an instance and of a kept state
   GET_STATE, SET_STATE, FREE_STATE, STATE_SIZE, SERIALIZE, DESERIALIZE  functions that the versions spell differently
   VALUE_COUNT, AS_MANY  the last argument of a getter or setter, if there is one, and whether it is the number of references */
#ifndef FMU_FUNCTIONS_H
#define FMU_FUNCTIONS_H

#include "fmu_instance.h"

#define REQUIRE(modes)                      \
    do {                                    \
        if (!allowed(c, modes, __func__)) { \
            return FMI(Error);              \
        }                                   \
    } while (0)
#define WRITABLE (INSTANTIATED | INITIALIZING | STEPPING)
#define ALIVE (INSTANTIATED | INITIALIZING | STEPPING | TERMINATED)

/* ---- the model's life ---- */

const char *FMI(GetVersion)(void) { return FMI(Version); }

void FMI(FreeInstance)(HANDLE c) { unmake(c); }

FMI(Status) FMI(SetDebugLogging)(HANDLE c, FMI(Boolean) logging, size_t count, const FMI(String) categories[])
{
    instance *one = c;
    (void)count;
    (void)categories;
    REQUIRE(ALIVE);
    one->logging = logging;
    return FMI(OK);
}

FMI(Status) FMI(ExitInitializationMode)(HANDLE c)
{
    REQUIRE(INITIALIZING);
    return (FMI(Status))initialize(c);
}

FMI(Status) FMI(Terminate)(HANDLE c)
{
    instance *one = c;
    REQUIRE(STEPPING);
    one->now.mode = TERMINATED;
    return FMI(OK);
}

FMI(Status) FMI(Reset)(HANDLE c)
{
    REQUIRE(ALIVE);
    begin(c);
    return FMI(OK);
}

/* ---- variables ---- */

/* One getter or setter a type: all values pass as double, which holds each of them exactly. No variable is an array. */
#define REQUIRE_AS_MANY                                                                                    \
    do {                                                                                                   \
        if (!AS_MANY) {                                                                                    \
            return (FMI(Status))tell(c, ERROR, "logStatusError", "%s: no variable is an array", __func__); \
        }                                                                                                  \
    } while (0)
#define GETTER(name, type, kind)                                                                        \
    FMI(Status) name(HANDLE c, const FMI(ValueReference) vr[], size_t count, type values[] VALUE_COUNT) \
    {                                                                                                   \
        int status = OK;                                                                                \
        size_t i;                                                                                       \
        REQUIRE(ALIVE);                                                                                 \
        REQUIRE_AS_MANY;                                                                                \
        for (i = 0; i < count && status == OK; i++) {                                                   \
            double number = 0.0;                                                                        \
            status = get(c, vr[i], kind, &number);                                                      \
            values[i] = (type)number;                                                                   \
        }                                                                                               \
        return (FMI(Status))status;                                                                     \
    }
#define SETTER(name, type, kind)                                                                              \
    FMI(Status) name(HANDLE c, const FMI(ValueReference) vr[], size_t count, const type values[] VALUE_COUNT) \
    {                                                                                                         \
        int status = OK;                                                                                      \
        size_t i;                                                                                             \
        REQUIRE(WRITABLE);                                                                                    \
        REQUIRE_AS_MANY;                                                                                      \
        for (i = 0; i < count && status == OK; i++) {                                                         \
            status = set(c, vr[i], kind, (double)values[i]);                                                  \
        }                                                                                                     \
        return (FMI(Status))status;                                                                           \
    }

/* ---- states ---- */

FMI(Status) GET_STATE(HANDLE c, STATE *state)
{
    REQUIRE(ALIVE);
    return (FMI(Status))keep(c, state);
}

FMI(Status) SET_STATE(HANDLE c, STATE state)
{
    REQUIRE(ALIVE);
    return (FMI(Status))restore(c, state);
}

FMI(Status) FREE_STATE(HANDLE c, STATE *state)
{
    REQUIRE(ALIVE);
    drop(state);
    return FMI(OK);
}

FMI(Status) STATE_SIZE(HANDLE c, STATE state, size_t *size)
{
    (void)state;
    REQUIRE(ALIVE);
    *size = SERIALIZED;
    return FMI(OK);
}

FMI(Status) SERIALIZE(HANDLE c, STATE state, FMI(Byte) bytes[], size_t size)
{
    REQUIRE(ALIVE);
    return (FMI(Status))serialize(c, state, bytes, size);
}

FMI(Status) DESERIALIZE(HANDLE c, const FMI(Byte) bytes[], size_t size, STATE *state)
{
    REQUIRE(ALIVE);
    return (FMI(Status))deserialize(c, bytes, size, state);
}

/* A function of the standard that this model does not provide. */
#define ABSENT(name, ...)                                                                                   \
    FMI(Status) name(HANDLE c, __VA_ARGS__)                                                                 \
    {                                                                                                       \
        REQUIRE(ALIVE);                                                                                     \
        return (FMI(Status))tell(c, ERROR, "logStatusError", "%s: this FMU does not provide it", __func__); \
    }

#endif
