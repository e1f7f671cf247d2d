/* Active disturbance rejection with a GPI observer of seven states. */
#include "axis.h"

#define N 7

typedef struct {
    guard guard;
    double F[N][N], Gu[N], Gy[N];
    double mass, share, limit, alpha1, alpha0; /* 2 zeta omega, omega² of the controller */
    double omega, scale;                       /* of the observer: omega_o, mass omega_o² */
    double z[N], position;
} controller;

/* One row of F z + Gu u + Gy change, unrolled. */
#define ROW(i)                                                                                                         \
    (c->F[i][0] * z0 + c->F[i][1] * z1 + c->F[i][2] * z2 + c->F[i][3] * z3 + c->F[i][4] * z4 + c->F[i][5] * z5 +       \
     c->F[i][6] * z6 + c->Gu[i] * applied + c->Gy[i] * change)

void hand_step(controller *c, const inputs *in, outputs *out)
{
    seen now;
    const double applied = c->guard.applied, T = c->guard.T;
    double z0 = c->z[0], z1 = c->z[1], z2 = c->z[2], z3 = c->z[3], z4 = c->z[4], z5 = c->z[5], z6 = c->z[6];
    guard_before(&c->guard, in, &now);
    if (!now.ran) {
        z0 = z3 = z4 = z5 = z6 = 0.0;
        z1 = c->guard.travel / T / c->omega;
        z2 = -applied / c->scale;
        c->position = now.before_load;
    }
    const double change = now.load - c->position;
    const double next1 = ROW(1), next2 = ROW(2);
    c->z[0] = ROW(0), c->z[1] = next1, c->z[2] = next2;
    c->z[3] = ROW(3), c->z[4] = ROW(4), c->z[5] = ROW(5), c->z[6] = ROW(6);
    c->position = now.load;
    const double disturbance = c->scale * next2, velocity = c->omega * next1;
    const double half = 0.5 * T;
    const double a = now.a + half * (now.j + 0.5 * half * now.s);
    const double wanted = a - c->alpha1 * (velocity - now.v) - c->alpha0 * (now.load - now.x);
    const double force = c->mass * wanted - c->share * disturbance;
    guard_after(&c->guard, &now, clip(force, c->limit), force, out);
}
