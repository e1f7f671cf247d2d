/* The loop of workload.py, written by hand: one run, six signals recorded.  Same equations, same order of operations. */
#include <math.h>

typedef struct {
    double position_gain, velocity_gain, integral_time, velocity_feedforward; /* 1/s, N s/m, s, - */
    double feedforward_mass, feedforward_viscous;                             /* kg, N s/m */
    double force_limit;                                                       /* N */
    double coulomb, breakaway, stribeck_velocity;                             /* N, N, m/s */
    double count_motor, count_load;                                           /* m */
    double T;                                                                 /* s */
    double b0, b1, b2, a2;                                                    /* notch */
    double change[4][4], drive[4], load[4]; /* exact hold of x1, x2, v1, v2 over a substep */
} Parameters;

typedef struct {
    double reading, integral, first, second, applied, requested, pending, x1, x2, v1, v2;
} State;

static inline double clip(double x, double low, double high)
{
    x = x < low ? low : x;
    return x > high ? high : x;
}

void run(long count, const Parameters *restrict p, const double (*restrict setpoint)[5], State *restrict state,
         double (*restrict record)[6])
{
    State s = *state;
    const double T = p->T, half = 0.5 * T;
    const double integral_gain = p->velocity_gain * T / p->integral_time;
    const double extra = p->breakaway - p->coulomb;
    const double mobility = p->load[3];
    const double half_step = 0.5 * (T / SUBSTEPS);

    for (long k = 0; k < count; k++) {
        const double position = setpoint[k][0], velocity = setpoint[k][1], acceleration = setpoint[k][2],
                     jerk = setpoint[k][3], snap = setpoint[k][4];

        /* encoders */
        const double motor = p->count_motor * floor(s.x1 / p->count_motor + 0.5);
        const double load = p->count_load * floor(s.x2 / p->count_load + 0.5);

        /* P-PI, with back-calculation one sample later */
        const double measured = (motor - s.reading) / T;
        const double backward =
            velocity - T * (0.5 * acceleration - T * ((1.0 / 6.0) * jerk - T * ((1.0 / 24.0) * snap)));
        double e = p->position_gain * (position - load);
        e = e + p->velocity_feedforward * backward;
        e = e - measured;
        s.integral = s.integral + (s.applied - s.requested);
        s.integral = s.integral + integral_gain * e;
        const double u = p->velocity_gain * e + s.integral;
        s.reading = motor;

        /* notch */
        const double y = p->b0 * u + s.first;
        s.first = p->b1 * (u - y) + s.second;
        s.second = p->b2 * u - p->a2 * y;

        /* feedforward in the middle of the sample */
        const double a = acceleration + half * (jerk + 0.5 * half * snap);
        const double v = velocity + half * (acceleration + 0.5 * half * (jerk + (1.0 / 3.0) * (half * snap)));
        s.requested = y + (p->feedforward_mass * a + p->feedforward_viscous * v);
        s.applied = clip(s.requested, -p->force_limit, p->force_limit);

        record[k][0] = s.x2;
        record[k][1] = s.v2;
        record[k][2] = position - load;
        record[k][3] = s.applied;
        record[k][5] = motor;

        /* the axis, under the force of the last sample */
        double friction = 0.0;
        for (int substep = 0; substep < SUBSTEPS; substep++) {
            double free[4];
            const double x[4] = {s.x1, s.x2, s.v1, s.v2};
            for (int i = 0; i < 4; i++)
                free[i] = x[i] + (p->change[i][0] * x[0] + p->change[i][1] * x[1] + p->change[i][2] * x[2] +
                                  p->change[i][3] * x[3] + p->drive[i] * s.pending);
            const double stopping = -free[3] / mobility;
            const double guess = free[3] + mobility * clip(stopping, -p->breakaway, p->breakaway);
            const double ratio = 0.5 * (s.v2 + guess) / p->stribeck_velocity;
            const double level = p->coulomb + extra * exp(-(ratio * ratio));
            friction = clip(stopping, -level, level);
            s.x1 = free[0] + p->load[0] * friction;
            s.v1 = free[2] + p->load[2] * friction;
            const int stuck = fabs(stopping) <= level;
            s.x2 = stuck ? s.x2 + half_step * s.v2 : free[1] + p->load[1] * friction;
            s.v2 = stuck ? 0.0 : free[3] + mobility * friction;
        }
        record[k][4] = friction;
        s.pending = s.applied;
    }
    *state = s;
}
