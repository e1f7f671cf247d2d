/* Laws by hand: a row of setpoint (position ... snap) and reading (motor, load, applied, requested) a sample, a force out.
   Same equations, same order of operations as the Python of each law. */

static double backward(const double *r, double T)
{
    return r[1] - T * (0.5 * r[2] - T * ((1.0 / 6.0) * r[3] - T * ((1.0 / 24.0) * r[4])));
}

/* p: mass, viscous, tracking_rate, reaching_rate, g1, g2, T;  s: position, sliding, estimate */
void dadsc(long count, const double *restrict p, const double (*restrict rows)[9], double *restrict s,
           double *restrict force)
{
    const double m = p[0], b = p[1], lambda = p[2], K = p[3], g1 = p[4], g2 = p[5], T = p[6], half = 0.5 * T;
    double last = s[0], sliding = s[1], estimate = s[2];
    for (long k = 0; k < count; k++) {
        const double *r = rows[k];
        const double v = (r[5] - last) / T;
        const double ex = r[0] - r[6];
        const double ev = backward(r, T) - v;
        const double now = lambda * ex + ev;
        estimate = (estimate + (r[8] - r[7])) - g1 * now + g2 * sliding;
        const double a = r[2] + half * (r[3] + 0.5 * half * r[4]);
        force[k] = m * (a + K * now + lambda * ev) - estimate + b * v;
        last = r[5];
        sliding = now;
    }
    s[0] = last, s[1] = sliding, s[2] = estimate;
}

/* p: Kv, Kp, Tn, velocity_feedforward, T;  s: position, integral */
void cascade_ppi(long count, const double *restrict p, const double (*restrict rows)[9], double *restrict s,
                 double *restrict force)
{
    const double Kv = p[0], Kp = p[1], Tn = p[2], share = p[3], T = p[4], gain = Kp * T / Tn;
    double last = s[0], integral = s[1];
    for (long k = 0; k < count; k++) {
        const double *r = rows[k];
        const double v = (r[5] - last) / T;
        const double wanted = Kv * (r[0] - r[6]) + share * backward(r, T);
        const double e = wanted - v;
        integral = (integral + (r[7] - r[8])) + gain * e;
        force[k] = Kp * e + integral;
        last = r[5];
    }
    s[0] = last, s[1] = integral;
}

/* p: K1, K2, K3, K4, Ki, led/k, dragged/k, lag, T;  s: motor, load, offset, integral, added */
void pole_placement(long count, const double *restrict p, const double (*restrict rows)[9], double *restrict s,
                    double *restrict force)
{
    const double K1 = p[0], K2 = p[1], K3 = p[2], K4 = p[3], Ki = p[4], per_a = p[5], per_v = p[6], lag = p[7], T = p[8];
    double motor = s[0], load = s[1], integral = s[3], added = s[4];
    const double offset = s[2];
    for (long k = 0; k < count; k++) {
        const double *r = rows[k];
        const double v1 = (r[5] - motor) / T, v2 = (r[6] - load) / T;
        const double e = r[0] - r[6];
        const double relaxed = per_a * r[2] + per_v * r[1];
        const double relaxed1 = per_a * r[3] + per_v * r[2];
        const double relaxed2 = per_a * r[4] + per_v * r[3];
        const double e1 = (r[0] - (r[5] - offset)) + (relaxed - lag * relaxed1);
        const double ev1 = (r[1] - v1) + (relaxed1 - lag * relaxed2);
        const double ev2 = r[1] - v2;
        const double kept = r[7] == r[8] ? integral : integral - added;
        added = T * e;
        integral = kept + added;
        force[k] = K1 * e1 + K2 * e + K3 * ev1 + K4 * ev2 + Ki * integral;
        motor = r[5];
        load = r[6];
    }
    s[0] = motor, s[1] = load, s[3] = integral, s[4] = added;
}

/* p: mass, omega_c, zeta_c, share, omega_o, F (7 x 7), Gu (7), Gy (7), T;  s: z (7), position */
void gpi(long count, const double *restrict p, const double (*restrict rows)[9], double *restrict s,
         double *restrict force)
{
    enum { N = 7 };
    const double mass = p[0], wc = p[1], zc = p[2], share = p[3], wo = p[4], T = p[5 + N * N + 2 * N], half = 0.5 * T;
    const double alpha0 = wc * wc, alpha1 = 2.0 * zc * wc, scale = mass * wo * wo;
    double F[N][N], Gu[N], Gy[N], z[N], last = s[N];
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++)
            F[i][j] = p[5 + N * i + j];
        Gu[i] = p[5 + N * N + i];
        Gy[i] = p[5 + N * N + N + i];
        z[i] = s[i];
    }
    for (long k = 0; k < count; k++) {
        const double *r = rows[k];
        const double change = r[6] - last;
        double next[N];
        for (int i = 0; i < N; i++) {
            double sum = F[i][0] * z[0];
            for (int j = 1; j < N; j++)
                sum = sum + F[i][j] * z[j];
            sum = sum + Gu[i] * r[7];
            next[i] = sum + Gy[i] * change;
        }
        for (int i = 0; i < N; i++)
            z[i] = next[i];
        const double velocity = wo * z[1], disturbance = scale * z[2];
        const double a = r[2] + half * (r[3] + 0.5 * half * r[4]);
        const double slower = alpha1 * (velocity - r[1]), nearer = alpha0 * (r[6] - r[0]);
        force[k] = mass * ((a - slower) - nearer) - share * disturbance;
        last = r[6];
    }
    for (int i = 0; i < N; i++)
        s[i] = z[i];
    s[N] = last;
}
