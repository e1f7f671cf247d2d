#include <float.h>
#include <stdlib.h>
#include <string.h>

enum { AXES = ${axes} };

/* One instance: the laws of the axes, with the machine's own numbers in them. */
static ${P}_controller core;
static ${P}_parameters acting; /* the parameters that act */
static bool started, was_on[AXES], was_asked, bad;
static double scale;    /* length units in a metre */
static int fault_now[AXES]; /* code of the fault of each axis, kept until the next rising edge of enable or reset */
static long long called; /* time of the last call, ns */
static ${P}_parameters judged; /* the parameters that were last looked at */
static int rule;               /* the rule that these break, or 0 */

FUNCTION(_)
{
    const ${P}_parameters wanted = {${wanted}};
    const long long now = rtapi_get_time();
    const bool asked = reset;
    const bool enables[AXES] = {${enables}};
    bool on[AXES];
    bool fine = true;

    if (!started)
        scale = units_per_m;
    const bool changed = !started || memcmp(&wanted, &acting, sizeof acting) != 0;
    if (!started || memcmp(&wanted, &judged, sizeof judged) != 0) {
        judged = wanted;
        rule = ${P}_broken_rule(&judged);
    }
    if (!changed || !hold_parameters)
        bad = !(scale > 0.0 && scale <= DBL_MAX) || (changed && rule != 0) || rule < 0;

    for (int i = 0; i < AXES; i++) {
        on[i] = enables[i];
        /* a reset alone must not start a motion */
        if ((on[i] && !was_on[i]) || (asked && !was_asked && !on[i]))
            fault_now[i] = on[i] && bad ? ${parameter_fault} : 0;
        was_on[i] = on[i];
        /* watchdog: the law is made for one period, and an axis must not be left alone with an old command */
        if (labs(period - ${period}L) > (long)period_tolerance)
            fault_now[i] = ${period_fault};
        else if (started && on[i] && late_limit > 0 && now - called > (long long)late_limit && fault_now[i] == 0)
            fault_now[i] = ${late_fault};
        on[i] = on[i] && fault_now[i] < ${period_fault}; /* the guard latches its own trips */
    }
    was_asked = asked;
    called = now;

    /* numbers below the normal ones count as zero, as in the simulation */
    const uint64_t mode = ${P}_flush_begin();
    if (!started) {
        if (bad || hold_parameters)
            ${P}_defaults(&acting);
        else
            acting = wanted;
        ${P}_configure(&core, &acting);
    } else if (changed && !bad && !hold_parameters) {
        acting = wanted;
        ${P}_retune(&core, &acting);
        retunes = retunes + 1;
    }

    const ${P}_inputs given = {${inputs}};
    ${P}_outputs result;
    if (!started)
        ${P}_reset(&core, &given);
    ${P}_step(&core, &given, &result);
    ${P}_flush_end(mode);
    started = true;

${outputs}
    ok = fine;
    if (fine)
        heartbeat = !heartbeat;
    parameter_bad = bad;
    parameter_rule = bad ? rule : 0;
}
