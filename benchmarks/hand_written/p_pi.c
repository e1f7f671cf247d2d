/* P position loop around a PI velocity loop. */
#include "axis.h"

typedef struct {
    guard guard;
    double Kv, Kp, share, limit, integral_gain; /* integral_gain = Kp T / Tn */
    double position, integral;
} controller;

void hand_step(controller *c, const inputs *in, outputs *out)
{
    seen now;
    const double applied = c->guard.applied, requested = c->guard.requested, T = c->guard.T;
    guard_before(&c->guard, in, &now);
    if (!now.ran) {
        c->position = now.before_motor;
        c->integral = applied;
    }
    const double velocity = (now.motor - c->position) / T;
    const double wanted = c->Kv * (now.x - now.load) + c->share * backward_velocity(&now, T);
    const double e = wanted - velocity;
    c->position = now.motor;
    c->integral = c->integral + (applied - requested) + c->integral_gain * e;
    const double force = c->Kp * e + c->integral;
    guard_after(&c->guard, &now, clip(force, c->limit), force, out);
}
