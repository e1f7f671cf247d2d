/* The loop of workload.py, written by hand for W variants at once (C with vector extensions; the ternary operator on
   vectors needs the C++ front end).  Reductions instead of records: sum of squares, least and most of four signals, and
   the first sample outside of bounds.  Peaks follow from least and most.

   WIDTH      variants in a vector
   GROUPS     vectors that are interleaved by hand
   ESTRIN     the polynomial of exp in pairs instead of by Horner's rule */
#include <immintrin.h>
#include <stdint.h>

typedef double V __attribute__((vector_size(8 * WIDTH)));
typedef int64_t I __attribute__((vector_size(8 * WIDTH)));

struct Parameters {
    V position_gain, velocity_gain, integral_time, velocity_feedforward;
    V feedforward_mass, feedforward_viscous;
    V force_limit;
    V coulomb, breakaway, stribeck_velocity;
    V count_motor, count_load;
    V T;
    V b0, b1, b2, a2;
    V change[4][4], drive[4], load[4];
};

struct State {
    V reading, integral, first, second, applied, requested, pending, x1, x2, v1, v2;
};

struct Statistics {
    V squares[4], least[4], most[4], left;
};

#define SHIFTER 6755399441055744.0 /* 1.5 * 2^52: x + SHIFTER holds round(x) in its low bits */

static inline V rounded(V x) { return (x + SHIFTER) - SHIFTER; }
static inline V larger(V a, V b) { return a > b ? a : b; }
static inline V smaller(V a, V b) { return a < b ? a : b; }
static inline V clip(V x, V low, V high) { return smaller(larger(x, low), high); }

/* e^x for x <= 0: 2^k e^r with |r| <= ln2/2, a series to r^11 */
static inline V exponential(V x)
{
    x = larger(x, V{} - 708.0);
    const V shifted = x * 1.4426950408889634 + SHIFTER;
    const V k = shifted - SHIFTER;
    const V r = (x - k * 0.6931471805598903) - k * 5.497923018708371e-14;
#ifdef ESTRIN
    const V r2 = r * r, r4 = r2 * r2, r8 = r4 * r4;
    const V a = (0.5 + r * (1.0 / 6)) + r2 * (1.0 / 24 + r * (1.0 / 120));
    const V b = (1.0 / 720 + r * (1.0 / 5040)) + r2 * (1.0 / 40320 + r * (1.0 / 362880));
    const V c = 1.0 / 3628800 + r * (1.0 / 39916800);
    const V p = (a + r4 * b) + r8 * c;
#else
    V p = r * (1.0 / 39916800) + 1.0 / 3628800;
    p = p * r + 1.0 / 362880;
    p = p * r + 1.0 / 40320;
    p = p * r + 1.0 / 5040;
    p = p * r + 1.0 / 720;
    p = p * r + 1.0 / 120;
    p = p * r + 1.0 / 24;
    p = p * r + 1.0 / 6;
    p = p * r + 0.5;
    const V r2 = r * r;
#endif
    const V mantissa = (1.0 + r) + r2 * p;
    return (V)((I)mantissa + ((I)shifted << 52));
}

static inline void gather(Statistics *g, int i, V x)
{
    g->squares[i] += x * x;
    g->least[i] = smaller(g->least[i], x);
    g->most[i] = larger(g->most[i], x);
}

static inline void sample(const Parameters *p, State *s, Statistics *g, long k, const double *set, double backward,
                          double feed_acceleration, double feed_velocity, double half_step, V bound)
{
    const V motor = p->count_motor * rounded(s->x1 / p->count_motor);
    const V load = p->count_load * rounded(s->x2 / p->count_load);

    const V measured = (motor - s->reading) / p->T;
    const V e = p->position_gain * (set[0] - load) + p->velocity_feedforward * backward - measured;
    s->integral += (s->applied - s->requested) + p->velocity_gain * p->T / p->integral_time * e;
    const V u = p->velocity_gain * e + s->integral;
    s->reading = motor;

    const V y = p->b0 * u + s->first;
    s->first = p->b1 * (u - y) + s->second;
    s->second = p->b2 * u - p->a2 * y;

    s->requested = y + (p->feedforward_mass * feed_acceleration + p->feedforward_viscous * feed_velocity);
    s->applied = clip(s->requested, -p->force_limit, p->force_limit);

    gather(g, 0, set[0] - load);
    const V tracking = set[0] - s->x2;
    gather(g, 1, tracking);
    gather(g, 2, s->applied);
    gather(g, 3, s->v2);
    const V size = larger(tracking, -tracking);
    g->left = ((size > bound) & (g->left < 0.0)) ? V{} + (double)k : g->left;

    for (int substep = 0; substep < SUBSTEPS; substep++) {
        V free[4];
        for (int i = 0; i < 4; i++) {
            const V x = i == 0 ? s->x1 : i == 1 ? s->x2 : i == 2 ? s->v1 : s->v2;
            free[i] = x + (p->change[i][0] * s->x1 + p->change[i][1] * s->x2 + p->change[i][2] * s->v1 +
                           p->change[i][3] * s->v2 + p->drive[i] * s->pending);
        }
        const V mobility = p->load[3];
        const V stopping = -free[3] / mobility;
        const V guess = free[3] + mobility * clip(stopping, -p->breakaway, p->breakaway);
        const V ratio = 0.5 * (s->v2 + guess) / p->stribeck_velocity;
        const V level = p->coulomb + (p->breakaway - p->coulomb) * exponential(-(ratio * ratio));
        const V friction = clip(stopping, -level, level);
        s->x1 = free[0] + p->load[0] * friction;
        s->v1 = free[2] + p->load[2] * friction;
        const I stuck = larger(stopping, -stopping) <= level;
        s->x2 = stuck ? s->x2 + half_step * s->v2 : free[1] + p->load[1] * friction;
        s->v2 = stuck ? V{} : free[3] + mobility * friction;
    }
    s->pending = s->applied;
}

extern "C" void run(long count, double T, const Parameters *parameters, const double (*setpoint)[5], State *states,
                    Statistics *statistics, double limit)
{
    const unsigned mode = _mm_getcsr();
    _mm_setcsr(mode | 0x8040); /* numbers below the normal ones are 0 */
    Parameters p[GROUPS];
    State s[GROUPS];
    Statistics g[GROUPS];
    for (int i = 0; i < GROUPS; i++) {
        p[i] = parameters[i];
        s[i] = states[i];
        g[i] = statistics[i];
    }
    const V bound = V{} + limit;
    const double half = 0.5 * T;
    for (long k = 0; k < count; k++) {
        const double *set = setpoint[k];
        const double backward =
            set[1] - T * (0.5 * set[2] - T * ((1.0 / 6.0) * set[3] - T * ((1.0 / 24.0) * set[4])));
        const double a = set[2] + half * (set[3] + 0.5 * half * set[4]);
        const double v = set[1] + half * (set[2] + 0.5 * half * (set[3] + (1.0 / 3.0) * (half * set[4])));
        _Pragma("GCC unroll 4")
        for (int i = 0; i < GROUPS; i++)
            sample(&p[i], &s[i], &g[i], k, set, backward, a, v, half / SUBSTEPS, bound);
    }
    for (int i = 0; i < GROUPS; i++) {
        states[i] = s[i];
        statistics[i] = g[i];
    }
    _mm_setcsr(mode);
}
