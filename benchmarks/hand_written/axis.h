/* What a control engineer would write by hand around a law: inputs, outputs, and the guard of an axis with two encoders.
   The same bits as `Guard` with its defaults: a broken number holds the command for hold_samples, then the loop trips. */
#ifndef AXIS_H
#define AXIS_H

#include <math.h>
#include <stdbool.h>

typedef struct {
    double set_position, set_velocity, set_acceleration, set_jerk, set_snap; /* m, m/s, ... */
    double reading_motor, reading_load;                                      /* m */
    double enable;
} inputs;

typedef struct {
    double force, command, trip, enabled;
} outputs;

typedef struct {
    double T, reading_limit, hold_samples, safe_force, force_per_unit;
    double mode; /* 1 + broken samples in a row while running, 0 off, -code tripped */
    double motor, load, offset, travel, set_position;
    double applied, requested; /* N, of the last sample */
} guard;

/* What the law may see. */
typedef struct {
    bool usual, ran, good;
    double x, v, a, j, s; /* setpoint */
    double motor, load;
    double before_motor, before_load; /* one sample earlier, to start from */
} seen;

static inline void guard_unusual(guard *g, const inputs *in, seen *now, bool good_motor, bool good_load,
                                 bool good_setpoint)
{
    const double motor = good_motor ? in->reading_motor : g->motor + g->travel;
    const double load = good_load ? in->reading_load : g->load + g->travel;
    if (good_setpoint) {
        now->x = in->set_position, now->v = in->set_velocity, now->a = in->set_acceleration;
        now->j = in->set_jerk, now->s = in->set_snap;
    } else {
        now->x = g->set_position + g->travel, now->v = g->travel / g->T;
        now->a = now->j = now->s = 0.0;
    }
    if (!(in->enable > 0.5)) {
        g->mode = 0.0;
    } else if (!(g->mode < 0.0)) {
        if (now->good) {
            g->mode = 1.0;
        } else if (now->ran && g->mode <= g->hold_samples) {
            g->mode = g->mode + 1.0;
        } else {
            g->mode = -1.0;
        }
    }
    const double moved = load - g->load;
    if (now->ran) {
        g->travel = moved;
    } else {
        g->offset = motor - load;
        g->travel = g->travel + 0.03125 * (moved - g->travel);
    }
    now->before_motor = g->motor - g->offset;
    now->before_load = g->load;
    now->motor = motor - g->offset;
    now->load = load;
    g->motor = motor, g->load = load, g->set_position = now->x;
}

static inline void guard_before(guard *g, const inputs *in, seen *now)
{
    const bool good_motor = fabs(in->reading_motor) <= g->reading_limit;
    const bool good_load = fabs(in->reading_load) <= g->reading_limit;
    const double sum = fabs(in->set_position) + fabs(in->set_velocity) + fabs(in->set_acceleration) +
                       fabs(in->set_jerk) + fabs(in->set_snap);
    const bool good_setpoint = sum <= 1e12;
    now->ran = g->mode > 0.5;
    now->good = good_motor && good_load && good_setpoint;
    now->usual = now->good && in->enable > 0.5 && now->ran;
    if (!now->usual) {
        guard_unusual(g, in, now, good_motor, good_load, good_setpoint);
        return;
    }
    now->x = in->set_position, now->v = in->set_velocity, now->a = in->set_acceleration;
    now->j = in->set_jerk, now->s = in->set_snap;
    now->motor = in->reading_motor - g->offset;
    now->load = in->reading_load;
    g->travel = in->reading_load - g->load;
    g->mode = 1.0;
    g->motor = in->reading_motor, g->load = in->reading_load, g->set_position = in->set_position;
}

static inline void guard_after(guard *g, const seen *now, double applied, double requested, outputs *out)
{
    const bool sound = fabs(requested) <= 1e18;
    if (!(now->usual && sound)) {
        if (g->mode > 0.5 && !sound) {
            g->mode = -5.0;
        }
        if (!(g->mode > 0.5)) {
            applied = requested = g->safe_force;
        } else if (!now->good) {
            applied = requested = g->applied;
        }
    }
    g->applied = applied, g->requested = requested;
    out->force = applied;
    out->command = applied / g->force_per_unit;
    out->trip = g->mode < 0.0 ? -g->mode : 0.0;
    out->enabled = g->mode > 0.5 ? 1.0 : 0.0;
}

static inline double clip(double x, double limit)
{
    x = x < -limit ? -limit : x;
    return limit < x ? limit : x;
}

static inline double backward_velocity(const seen *now, double T)
{
    return now->v - T * (0.5 * now->a - T * ((1.0 / 6.0) * now->j - T * ((1.0 / 24.0) * now->s)));
}

#endif
