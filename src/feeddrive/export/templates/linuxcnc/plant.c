#include <float.h>

static ${P}_plant core;
static ${P}_outputs now; /* what the encoders read at the next sample */
static double scale;
static bool started;

FUNCTION(read)
{
    if (!started) {
        const ${P}_parameters wanted = {${wanted}};
        scale = units_per_m > 0.0 && units_per_m <= DBL_MAX ? units_per_m : 1000.0;
        const ${P}_inputs given = {${inputs}};
        ${P}_configure(&core, &wanted);
        ${P}_reset(&core, &given, &now);
        started = true;
    }
${outputs}
}

FUNCTION(write)
{
    if (started && !held) {
        const ${P}_inputs given = {${inputs}};
        const uint64_t mode = ${P}_flush_begin();
        ${P}_step(&core, &given, &now);
        ${P}_flush_end(mode);
    }
}
