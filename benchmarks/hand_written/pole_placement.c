/* State feedback of screw and table, with the set position of the screw by its series. */
#include "axis.h"

typedef struct {
    guard guard;
    double K1, K2, K3, K4, Ki, limit;
    double per_a, per_v, lag; /* of the series: led/k, dragged/k, c/k */
    double motor, load, offset, integral, added;
} controller;

void hand_step(controller *c, const inputs *in, outputs *out)
{
    seen now;
    const double applied = c->guard.applied, requested = c->guard.requested, T = c->guard.T;
    guard_before(&c->guard, in, &now);
    if (!now.ran) {
        c->motor = now.before_motor;
        c->load = now.before_load;
        c->offset = now.before_motor - now.before_load;
        c->integral = applied / c->Ki;
        c->added = 0.0;
    }
    const double v1 = (now.motor - c->motor) / T, v2 = (now.load - c->load) / T;
    const double e = now.x - now.load;
    const double relaxed = c->per_a * now.a + c->per_v * now.v;
    const double relaxed1 = c->per_a * now.j + c->per_v * now.a;
    const double relaxed2 = c->per_a * now.s + c->per_v * now.j;
    const double e1 = now.x - (now.motor - c->offset) + (relaxed - c->lag * relaxed1);
    const double ev1 = now.v - v1 + (relaxed1 - c->lag * relaxed2);
    const double ev2 = now.v - v2;
    const double added = T * e;
    if (applied != requested) {
        c->integral = c->integral - c->added; /* the limit cut something off: that sample does not count */
    }
    c->integral = c->integral + added;
    c->added = added;
    c->motor = now.motor, c->load = now.load;
    const double force = c->K1 * e1 + c->K2 * e + c->K3 * ev1 + c->K4 * ev2 + c->Ki * c->integral;
    guard_after(&c->guard, &now, clip(force, c->limit), force, out);
}
