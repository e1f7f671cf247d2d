/* Three axes as in single.c with a milling cut between them, written by hand: the machine of cut.py. */
#include <math.h>
#include <string.h>

#define AXES 3
#define TEETH 4
#define SLICES 5
#define SURFACES 3

typedef struct {
    double position_gain, velocity_gain, integral_time, velocity_feedforward; /* 1/s, N s/m, s, - */
    double feedforward_mass, feedforward_viscous;                             /* kg, N s/m */
    double force_limit;                                                       /* N */
    double coulomb, breakaway, stribeck_velocity;                             /* N, N, m/s */
    double count_motor, count_load;                                           /* m */
    double b0, b1, b2, a2;                                                    /* notch */
    double change[4][4], drive[4], load[4]; /* exact hold of x1, x2, v1, v2 over a substep */
} Axis;

typedef struct {
    double diameter, depth, helix;           /* m, m, rad */
    double Ktc, Krc, Kac, Kte, Kre, Kae;     /* N/m2, N/m */
    double speed;                            /* rpm */
} Cutter;

typedef struct {
    Axis axis[AXES];
    Cutter cutter;
    double T;
} Parameters;

typedef struct {
    double reading, integral, first, second, applied, requested, pending, x1, x2, v1, v2;
} State;

/* The past of the tool along x and y at the ends of the substeps. */
typedef struct {
    double position[LENGTH][2], velocity[LENGTH][2];
    long count;
} Past;

static inline double clip(double x, double low, double high)
{
    x = x < low ? low : x;
    return x > high ? high : x;
}

/* Where the tool was `ago` substeps before the newest one, predicted by half a substep. */
static inline void earlier(const Past *past, const double first[2], double ago, double h, double at[2])
{
    const double whole = floor(ago), s = 1.0 - (ago - whole), rest = 1.0 - s;
    const long newer = past->count - 1 - (long)whole, older = newer - 1;
    const double gained = s * s * (3.0 - 2.0 * s) + 3.0 * s * rest;
    const double from_old = h * (s * rest * rest + 0.5 * rest * (1.0 - 3.0 * s));
    const double from_new = h * (0.5 * s * (3.0 * s - 2.0) - s * s * rest);
    for (int i = 0; i < 2; i++) {
        const double x1 = newer < 0 ? first[i] : past->position[newer & (LENGTH - 1)][i];
        const double v1 = newer < 0 ? 0.0 : past->velocity[newer & (LENGTH - 1)][i];
        const double x0 = older < 0 ? first[i] : past->position[older & (LENGTH - 1)][i];
        const double v0 = older < 0 ? 0.0 : past->velocity[older & (LENGTH - 1)][i];
        at[i] = x0 + gained * (x1 - x0) + (from_new * v1 + from_old * v0);
    }
}

/* Force on the tool along x, y and z; a slot with the feed along x. */
static inline void cutting(const Cutter *c, Past *past, const double first[2], const double place[2],
                           const double velocity[2], double time, double h, double force[3])
{
    const double pi = 3.141592653589793;
    const long now = past->count & (LENGTH - 1);
    for (int i = 0; i < 2; i++) {
        past->position[now][i] = place[i] - 0.5 * h * velocity[i];
        past->velocity[now][i] = velocity[i];
    }
    past->count++;
    const double rate = c->speed / 60.0, turns = rate * time;
    const double angle = 2.0 * pi * (turns - floor(turns)), ago = 1.0 / (TEETH * rate * h);
    double moved[SURFACES][2];
    for (int m = 0; m < SURFACES; m++) {
        double at[2];
        earlier(past, first, (m + 1) * ago, h, at);
        moved[m][0] = place[0] - at[0];
        moved[m][1] = place[1] - at[1];
    }
    const double lag = 2.0 * c->depth * tan(c->helix) / c->diameter;
    const double width = fmax(lag / SLICES, 2.0 * pi * rate * h);
    const double tip = angle + 0.5 * (SLICES * width - lag);
    const double sine = sin(tip), cosine = cos(tip), back_s = sin(width), back_c = cos(width);
    const double tooth_s[TEETH] = {0.0, 1.0, 0.0, -1.0}, tooth_c[TEETH] = {1.0, 0.0, -1.0, 0.0};
    double hs = 0.0, hc = 0.0, chips = 0.0, all_s = 0.0, all_c = 0.0, all = 0.0;
    for (int tooth = 0; tooth < TEETH; tooth++) {
        double s = sine * tooth_c[tooth] + cosine * tooth_s[tooth];
        double co = cosine * tooth_c[tooth] - sine * tooth_s[tooth];
        double v = tip + 2.0 * pi * tooth / TEETH;
        v = v - 2.0 * pi * floor(v / (2.0 * pi));
        if (v > pi && v - SLICES * width > pi)
            continue; /* out of the work */
        double high = v, high_s = s, high_c = co;
        if (v > pi)
            high = pi, high_s = 0.0, high_c = -1.0;
        for (int slice = 0; slice < SLICES; slice++) {
            const double next_s = s * back_c - co * back_s;
            co = co * back_c + s * back_s;
            s = next_s;
            v = v - width;
            double low = v, low_s = s, low_c = co;
            if (v < 0.0)
                low = 0.0, low_s = 0.0, low_c = 1.0;
            else if (v > pi)
                low = pi, low_s = 0.0, low_c = -1.0;
            const double turned = high - low;
            if (turned > 0.0) {
                const double ds = high_s - low_s, dc = low_c - high_c;
                int least = 0;
                double chip = moved[0][0] * dc + moved[0][1] * ds;
                for (int m = 1; m < SURFACES; m++) {
                    const double other = moved[m][0] * dc + moved[m][1] * ds;
                    if (other < chip)
                        chip = other, least = m;
                }
                if (chip > 1e-12 * turned) {
                    const double both = high_s * high_c - low_s * low_c, mixed = high_s * high_s - low_s * low_s;
                    const double x = moved[least][0], y = moved[least][1];
                    hs += x * (turned - both) + y * mixed;
                    hc += x * mixed + y * (turned + both);
                    chips += chip, all_s += dc, all_c += ds, all += turned;
                }
            }
            high = low, high_s = low_s, high_c = low_c;
        }
    }
    const double factor = c->depth / (SLICES * width);
    force[0] = -factor * (0.5 * (c->Ktc * hc + c->Krc * hs) + c->Kte * all_c + c->Kre * all_s);
    force[1] = factor * (0.5 * (c->Ktc * hs - c->Krc * hc) + c->Kte * all_s - c->Kre * all_c);
    force[2] = -factor * (c->Kac * chips + c->Kae * all);
}

void run(long count, const Parameters *restrict p, const double (*restrict setpoint)[AXES][5], State *restrict state,
         Past *restrict past, double (*restrict record)[AXES][2])
{
    const double T = p->T, half = 0.5 * T, h = T / SUBSTEPS;
    const double first[2] = {state[0].x2, state[1].x2};
    past->count = 0;
    for (long k = 0; k < count; k++) {
        double new[AXES];
        for (int i = 0; i < AXES; i++) {
            const Axis *a = &p->axis[i];
            State *s = &state[i];
            const double position = setpoint[k][i][0], velocity = setpoint[k][i][1],
                         acceleration = setpoint[k][i][2], jerk = setpoint[k][i][3], snap = setpoint[k][i][4];
            const double motor = a->count_motor * floor(s->x1 / a->count_motor + 0.5);
            const double load = a->count_load * floor(s->x2 / a->count_load + 0.5);
            const double measured = (motor - s->reading) / T;
            const double backward =
                velocity - T * (0.5 * acceleration - T * ((1.0 / 6.0) * jerk - T * ((1.0 / 24.0) * snap)));
            double e = a->position_gain * (position - load);
            e = e + a->velocity_feedforward * backward;
            e = e - measured;
            s->integral = s->integral + (s->applied - s->requested);
            s->integral = s->integral + a->velocity_gain * T / a->integral_time * e;
            const double u = a->velocity_gain * e + s->integral;
            s->reading = motor;
            const double y = a->b0 * u + s->first;
            s->first = a->b1 * (u - y) + s->second;
            s->second = a->b2 * u - a->a2 * y;
            const double fed = acceleration + half * (jerk + 0.5 * half * snap);
            const double v = velocity + half * (acceleration + 0.5 * half * (jerk + (1.0 / 3.0) * (half * snap)));
            s->requested = y + (a->feedforward_mass * fed + a->feedforward_viscous * v);
            s->applied = clip(s->requested, -a->force_limit, a->force_limit);
            new[i] = s->applied;
            record[k][i][0] = s->x2;
            record[k][i][1] = 0.0;
        }
        for (int substep = 0; substep < SUBSTEPS; substep++) {
            double push[AXES];
            const double place[2] = {state[0].x2 + 0.5 * h * state[0].v2, state[1].x2 + 0.5 * h * state[1].v2};
            const double velocity[2] = {state[0].v2, state[1].v2};
            cutting(&p->cutter, past, first, place, velocity, (double)k * T + substep * h + 0.5 * h, h, push);
            for (int i = 0; i < AXES; i++) {
                const Axis *a = &p->axis[i];
                State *s = &state[i];
                const double mobility = a->load[3], extra = a->breakaway - a->coulomb;
                double free[4];
                const double x[4] = {s->x1, s->x2, s->v1, s->v2};
                for (int j = 0; j < 4; j++)
                    free[j] = x[j] + (a->change[j][0] * x[0] + a->change[j][1] * x[1] + a->change[j][2] * x[2] +
                                      a->change[j][3] * x[3] + a->drive[j] * s->pending + a->load[j] * push[i]);
                const double stopping = -free[3] / mobility;
                const double guess = free[3] + mobility * clip(stopping, -a->breakaway, a->breakaway);
                const double ratio = 0.5 * (s->v2 + guess) / a->stribeck_velocity;
                const double level = a->coulomb + extra * exp(-(ratio * ratio));
                const double friction = clip(stopping, -level, level);
                s->x1 = free[0] + a->load[0] * friction;
                s->v1 = free[2] + a->load[2] * friction;
                const int stuck = fabs(stopping) <= level;
                s->x2 = stuck ? s->x2 + 0.5 * h * s->v2 : free[1] + a->load[1] * friction;
                s->v2 = stuck ? 0.0 : free[3] + mobility * friction;
                record[k][i][1] += push[i] / SUBSTEPS;
            }
        }
        for (int i = 0; i < AXES; i++)
            state[i].pending = new[i];
    }
}
