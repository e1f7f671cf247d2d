#include <float.h>
#include <stdlib.h>
#include <string.h>

/* One instance: the law of one axis, with the machine's own numbers in it. */
static ${P}_controller core;
static ${P}_parameters acting; /* the parameters that act */
static bool started, was_on, was_asked, bad;
static double scale;    /* length units in a metre */
static int fault_now;   /* code of the fault, kept until the next rising edge of enable or reset */
static long long called; /* time of the last call, ns */
static ${P}_parameters judged; /* the parameters that were last looked at */
static int rule;               /* the rule that these break, or 0 */

FUNCTION(_)
{
    const ${P}_parameters wanted = {${wanted}};
    const long long now = rtapi_get_time();
    const bool asked = reset;
    bool on = enable;

    if (!started)
        scale = units_per_m;
    const bool changed = !started || memcmp(&wanted, &acting, sizeof acting) != 0;
    if (!started || memcmp(&wanted, &judged, sizeof judged) != 0) {
        judged = wanted;
        rule = ${P}_broken_rule(&judged);
    }
    if (!changed || !hold_parameters)
        bad = !(scale > 0.0 && scale <= DBL_MAX) || (changed && rule != 0) || rule < 0;

    /* a reset alone must not start a motion */
    if ((on && !was_on) || (asked && !was_asked && !on))
        fault_now = on && bad ? ${parameter_fault} : 0;
    was_on = on;
    was_asked = asked;
    /* watchdog: the law is made for one period, and an axis must not be left alone with an old command */
    if (labs(period - ${period}L) > (long)period_tolerance)
        fault_now = ${period_fault};
    else if (started && on && late_limit > 0 && now - called > (long long)late_limit && fault_now == 0)
        fault_now = ${late_fault};
    called = now;
    on = on && fault_now < ${period_fault}; /* the guard latches its own trips */

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

    force_cmd = result.force;
${drive}    running = result.enabled > 0.5;
    trip_code = (int)result.trip;
    if (fault_now == 0)
        fault_now = trip_code;
    fault = fault_now != 0;
    fault_code = fault_now;
    ok = fault_now == 0;
    if (fault_now == 0)
        heartbeat = !heartbeat;
    parameter_bad = bad;
    parameter_rule = bad ? rule : 0;
}
