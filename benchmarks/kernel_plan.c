/* kernel_plan.py, feeddrive/path/ramp.py and feeddrive/path/motion.py by hand: the same bits, without checks. */
#include <math.h>
#include <stdint.h>

typedef int64_t whole;
typedef struct { double a, b, c; } three;
typedef struct { whole count; double time, way; } end_of;

static double least(double a, double b) { return b < a ? b : a; }
static double most(double a, double b) { return b > a ? b : a; }

static double cube_root(double x) {
    if (x == 0.0 || x - x != 0.0) return x;
    double rest = x, scale = 1.0;
    while (rest >= 1.0) { rest *= 0.125; scale *= 2.0; }
    while (rest < 0.125) { rest *= 8.0; scale *= 0.5; }
    double root = 0.4 + 0.6 * rest;
    for (int i = 0; i < 5; i++) root -= (root - rest / (root * root)) / 3.0;
    return root * scale;
}

static three boxcars(double step, double A, double J, double S) {
    double rise = fabs(step);
    if (rise == 0.0) return (three){0.0, 0.0, 0.0};
    double first = least(least(J / S, sqrt(A / S)), cube_root(rise / (2.0 * S)));
    double reached = S * first;
    double full = 0.5 * (sqrt(first * first + 4.0 * rise / reached) - first);
    double second = most(first, least(A / reached, full));
    return (three){first, second, rise / (reached * second)};
}

static double ramp_distance(double start, double end, double A, double J, double S) {
    three w = boxcars(end - start, A, J, S);
    return 0.5 * (start + end) * (w.a + w.b + w.c);
}

static end_of ramp_pieces(double time, double position, double start, double end, double A, double J, double S,
                          double *times, double *pieces, whole count) {
    three w = boxcars(end - start, A, J, S);
    if (w.c == 0.0) return (end_of){count, time, position};
    double height = (end - start) / (w.a * w.b * w.c);
    double x = position, v = start, a = 0.0, j = 0.0;
    for (int phase = 0; phase < 7; phase++) {
        double sign = 0.0, t = w.a;
        if (phase == 0 || phase == 6) sign = 1.0;
        else if (phase == 2 || phase == 4) sign = -1.0;
        else if (phase == 3) t = w.c - w.b - w.a;
        else t = w.b - w.a;
        if (t > 0.0) {
            double s = sign * height, *p = pieces + 5 * count;
            times[count++] = time;
            p[0] = x; p[1] = v; p[2] = a / 2.0; p[3] = j / 6.0; p[4] = s / 24.0;
            x += t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))));
            v += t * (a + t * (j / 2.0 + t * (s / 6.0)));
            a += t * (j + t * (s / 2.0));
            j += t * s;
            time += t;
        }
    }
    return (end_of){count, time, position + 0.5 * (start + end) * (w.a + w.b + w.c)};
}

static double endless_speed(double start, double distance, double A, double J, double S) {
    if (distance <= 0.0) return start;
    double first = least(J / S, sqrt(A / S)), second = most(first, A / (S * first));
    double x = 0.0, v = start, a = 0.0, j = 0.0;
    for (int phase = 0; phase < 3; phase++) {
        double s = S * (1.0 - phase), t = phase == 1 ? second - first : first;
        double way = x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))));
        double speed = v + t * (a + t * (j / 2.0 + t * (s / 6.0)));
        if (way >= distance) {
            for (int i = 0; i < 60; i++) {
                double less = (way - distance) / speed;
                if (!(less > 1e-15 * t)) break;
                t -= less;
                way = x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))));
                speed = v + t * (a + t * (j / 2.0 + t * (s / 6.0)));
            }
            return speed;
        }
        x = way; v = speed; a += t * (j + t * (s / 2.0)); j += t * s;
    }
    return sqrt(v * v + 2.0 * a * (distance - x));
}

static whole lowest_cap(const double *ends, const double *caps, whole low, whole high, double start, double end,
                        const double *l, double *cap) {
    whole found = -1;
    double lowest = 0.0, highest = 0.0;
    for (whole k = low; k < high; k++) {
        highest = most(highest, caps[k]);
        if (found >= 0 && caps[k] >= lowest) continue;
        double from_start = endless_speed(start, ends[k + 1] - ends[low], l[0], l[1], l[2]);
        double from_end = endless_speed(end, ends[high] - ends[k], l[0], l[1], l[2]);
        if (from_start >= caps[k] && from_end >= caps[k]) { found = k; lowest = caps[k]; }
    }
    *cap = found < 0 ? highest : lowest;
    return found;
}

static double peak(double start, double end, double room, double cap, const double *l) {
    double low = most(start, end), high = cap;
    for (int i = 0; i < 50; i++) {
        double middle = 0.5 * (low + high), way = ramp_distance(start, middle, l[0], l[1], l[2]);
        way += ramp_distance(middle, end, l[0], l[1], l[2]);
        if (way <= room) low = middle; else high = middle;
    }
    return low;
}

static end_of held(double time, double position, double speed, double room, double *times, double *pieces,
                   whole count) {
    if (room <= 0.0) return (end_of){count, time, position};
    double *p = pieces + 5 * count;
    times[count] = time;
    p[0] = position; p[1] = speed; p[2] = p[3] = p[4] = 0.0;
    return (end_of){count + 1, time + room / speed, position + room};
}

static end_of plan(const double *ends, const double *caps, whole n, double A, double J, double S, whole *stack,
                   double *speeds, double *times, double *pieces) {
    double l[3] = {A, J, S};
    whole depth = 1;
    end_of e = {0, 0.0, 0.0};
    stack[0] = 0; stack[1] = 0; stack[2] = n;
    speeds[0] = speeds[1] = 0.0;
    while (depth > 0) {
        depth--;
        whole kind = stack[3 * depth], low = stack[3 * depth + 1], high = stack[3 * depth + 2];
        double start = speeds[2 * depth], end = speeds[2 * depth + 1], cap;
        if (low >= high) continue;
        double room = ends[high] - ends[low];
        if (kind == 1) { e = held(e.time, e.way, start, room, times, pieces, e.count); continue; }
        whole valley = lowest_cap(ends, caps, low, high, start, end, l, &cap);
        int fits = 0;
        if (valley >= 0 && cap > most(start, end)) {
            double before = ramp_distance(start, cap, A, J, S), behind = ramp_distance(cap, end, A, J, S);
            fits = before <= ends[valley] - ends[low] && behind <= ends[high] - ends[valley + 1];
        }
        if (fits) {
            for (int part = 0; part < 3; part++) {
                whole place = depth + part;
                stack[3 * place] = part == 1;
                stack[3 * place + 1] = part == 2 ? low : (part == 1 ? valley : valley + 1);
                stack[3 * place + 2] = part == 0 ? high : (part == 1 ? valley + 1 : valley);
                speeds[2 * place] = part == 2 ? start : cap;
                speeds[2 * place + 1] = part == 0 ? end : cap;
            }
            depth += 3;
            continue;
        }
        double top = peak(start, end, room, most(most(cap, start), end), l);
        double ways = ramp_distance(start, top, A, J, S) + ramp_distance(top, end, A, J, S);
        e = ramp_pieces(e.time, e.way, start, top, A, J, S, times, pieces, e.count);
        e = held(e.time, e.way, top, room - ways, times, pieces, e.count);
        e = ramp_pieces(e.time, e.way, top, end, A, J, S, times, pieces, e.count);
    }
    return e;
}

static whole piece_at(const double *times, whole count, double time, whole first) {
    whole low = first, stride = 1;
    while (low + stride < count && times[low + stride] <= time) { low += stride; stride *= 2; }
    whole high = low + stride < count ? low + stride : count;
    while (high - low > 1) {
        whole middle = (low + high) / 2;
        if (times[middle] <= time) low = middle; else high = middle;
    }
    return low;
}

static double derivative(const double *c, whole count, whole order, double t) {
    double value = 0.0;
    for (whole k = count - 1; k > order - 1; k--) {
        double factor = 1.0;
        for (whole m = 0; m < order; m++) factor *= (double)(k - m);
        value = value * t + factor * c[k];
    }
    return value;
}

whole plan_and_sample(const double *ends, const double *caps, whole n, double A, double J, double S, whole *stack,
                      double *speeds, double *times, double *pieces, const double *at, whole samples, double *values, whole width, whole orders) {
    end_of e = plan(ends, caps, n, A, J, S, stack, speeds, times, pieces);
    whole place = 0;
    for (whole k = 0; k < samples; k++) {
        place = piece_at(times, e.count, at[k], place);
        for (whole order = 0; order < orders; order++)
            values[orders * k + order] = derivative(pieces + width * place, width, order, at[k] - times[place]);
    }
    return e.count;
}
