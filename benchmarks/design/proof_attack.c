/* Sequences of sides, readings and disturbances against the C of an observer, beside its plant.
   A sequence is improved by its adjoint: the sides, noise, disturbances, roundings and first widths
   that enlarge the last |z - z^| most, as far as the run before shows.
   The plant runs in long double. Before each step plant and estimate move by the same vector, so
   that any side may follow any other: the error stays, and the theorem does not depend on it. */
#include "observer.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { POSITIONS = 8, PATIENCE = 40, ROUNDS = 16 };
typedef long double wide;
typedef struct { wide e[N + 2]; observer_state memory; } pair; /* errors: of x, right, left */
typedef struct {
    double phi[N * (N + 1)], c[N], x[N], s[(N + 2) * (N + 2)];
    double g[N + 2], slope, threshold, widest, noise, push, u, radius;
} setup;
typedef struct { double seen, fullest; long left; } result;

static unsigned long long random_state;

static double uniform(double low, double high)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return low + (high - low) * (double)(random_state >> 11) / 9007199254740992.0;
}

static wide output(const setup *s, const wide *x)
{
    wide z = 0;
    for (int i = 0; i < N; i++) z += s->c[i] * x[i];
    return z;
}

static double storage(const setup *s, const pair *now)
{
    double v = 0, e[N + 2];
    for (int i = 0; i < N + 2; i++) e[i] = (double)now->e[i];
    for (int i = 0; i < N + 2; i++)
        for (int j = 0; j < N + 2; j++) v += s->s[i * (N + 2) + j] * e[i] * e[j];
    return v;
}

/* Whether one step on a side (1, -1, 0, or 2 without a reading) is within the plant's range.
   `noise` and `push` are in [-1, 1]. */
static int advance_pair(const setup *s, pair *now, int side, double noise, double push)
{
    wide x[N], next[N], most = 0, part, z, right, left;
    double share = uniform(0.1, 0.9);
    observer_in in;
    observer_out out;
    right = now->e[N] + now->memory.right[0];
    left = now->e[N + 1] + now->memory.left[0];
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)uniform(-share * s->x[i], share * s->x[i]);
        x[i] = now->memory.x[i] + now->e[i];
        most += fabs(s->c[i]) * s->x[i];
    }
    wide far = (s->threshold + 1.01 * s->noise) / s->slope + uniform(1e-3, 0.1) * most;
    z = side == 1 ? right + far : side == -1 ? -left - far : uniform((double)-left, (double)right);
    part = (z - output(s, x)) / most;
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)(now->memory.x[i] + part * copysign(s->x[i], s->c[i]));
        x[i] = now->memory.x[i] + now->e[i];
        if (fabsl(x[i]) > s->x[i]) return 0; /* beyond the plant's range: not this step */
    }
    z = output(s, x);
    wide y = z > right ? z - right : z < -left ? z + left : 0;
    if ((side == 1 && y <= 0) || (side == -1 && y >= 0)) return 0;
    if (side == 0 && fabsl(y) * s->slope + s->noise > s->threshold) noise = 0;
    in.y[0] = side == 2 ? NAN : (REAL)(s->slope * y + (1 - 1e-3) * s->noise * noise);
    in.u[0] = (REAL)uniform(-s->u, s->u);
    for (int i = 0; i < N; i++) {
        next[i] = (wide)s->phi[i * (N + 1) + N] * (in.u[0] + s->push * push);
        for (int j = 0; j < N; j++) next[i] += (wide)s->phi[i * (N + 1) + j] * x[j];
    }
    observer_step(&now->memory, &in, &out);
    for (int i = 0; i < N; i++) now->e[i] = next[i] - now->memory.x[i];
    now->e[N] = right - now->memory.right[0];
    now->e[N + 1] = left - now->memory.left[0];
    return 1;
}

typedef struct {
    signed char side, noise, push;
    wide e[N + 2]; /* ahead of the step */
    wide toward[N + 2]; /* how the last z - z^ depends on the errors behind it */
    int ends[2]; /* whether it clips the widths */
} moment;

static wide weigh(const wide *toward, const wide *e)
{
    wide sum = 0;
    for (int i = 0; i < N + 2; i++) sum += toward[i] * e[i];
    return sum;
}

/* Take the steps of a plan, in float each at the worst of several positions. Return how many. */
static long run_plan(const setup *s, moment *plan, long steps, pair *now, result *found)
{
    for (long t = 0; t < steps; t++) {
        pair best = *now;
        wide highest = -INFINITY;
        int took = 0, most = sizeof(REAL) == sizeof(float) ? POSITIONS : 1;
        memcpy(plan[t].e, now->e, sizeof now->e);
        for (int k = 0; k < (took ? most : PATIENCE); k++) {
            pair trial = *now;
            if (!advance_pair(s, &trial, plan[t].side, plan[t].noise, plan[t].push)) continue;
            wide size = weigh(plan[t].toward, trial.e);
            if (size > highest) highest = size, best = trial;
            took = 1;
        }
        plan[t].ends[0] = best.memory.right[0] <= 0 || best.memory.right[0] >= s->widest;
        plan[t].ends[1] = best.memory.left[0] <= 0 || best.memory.left[0] >= s->widest;
        *now = best;
        double v = storage(s, now), z = (double)fabsl(output(s, now->e));
        found->seen = fmax(found->seen, z);
        found->fullest = fmax(found->fullest, v);
        if (v > 1 || z > s->radius) {
            found->left++;
            return t + 1;
        }
    }
    return steps;
}

/* Choose the sides (but a share of them that is kept), noise and pushes that enlarge the last z - z^
   to one sign. Leave its adjoint at the start. */
static void improve_plan(const setup *s, moment *plan, long steps, int sign, double kept, wide *toward)
{
    for (int i = 0; i < N + 2; i++) toward[i] = i < N ? sign * s->c[i] : 0;
    for (long t = steps - 1; t >= 0; t--) {
        wide back[N], pushed = 0, z = output(s, plan[t].e), slopes[2], gains[2];
        memcpy(plan[t].toward, toward, sizeof plan[t].toward);
        for (int i = 0; i < 2; i++)
            if (plan[t].ends[i]) toward[N + i] = 0;
        for (int j = 0; j < N; j++) {
            back[j] = 0;
            for (int i = 0; i < N; i++) back[j] += toward[i] * s->phi[i * (N + 1) + j];
            pushed += toward[j] * s->phi[j * (N + 1) + N];
        }
        for (int k = 0; k < 2; k++) { /* right, left */
            wide q = z + (k ? plan[t].e[N + 1] : -plan[t].e[N]);
            slopes[k] = (k ? -1 : 1) * (1 - s->g[N]) * toward[N + k];
            for (int i = 0; i < N; i++) slopes[k] -= s->g[i] * toward[i];
            gains[k] = slopes[k] * q + fabsl(slopes[k]) * s->noise / s->slope;
        }
        if (uniform(0, 1) >= kept) {
            plan[t].side = gains[0] <= 0 && gains[1] <= 0 ? (uniform(0, 1) < 0.5) * 2
                         : gains[0] > gains[1] ? 1 : -1;
        }
        plan[t].push = pushed > 0 ? 1 : -1;
        if (plan[t].side == 1 || plan[t].side == -1) {
            int k = plan[t].side < 0;
            plan[t].noise = slopes[k] > 0 ? 1 : -1;
            for (int i = 0; i < N; i++) back[i] += s->c[i] * slopes[k];
            toward[N + k] += k ? slopes[k] : -slopes[k];
        }
        memcpy(toward, back, sizeof back);
    }
}

static void begin_widths(const setup *s, pair *now, const wide *toward)
{
    double share = uniform(0, 3);
    observer_init(&now->memory);
    memset(now->e, 0, sizeof now->e);
    for (int k = 0; k < 2; k++) {
        double top = share < 1 ? uniform(0, s->widest) : s->widest;
        REAL *width = k ? now->memory.left : now->memory.right;
        width[0] = (REAL)(toward[N + k] > 0 ? 0 : top);
        now->e[N + k] = (toward[N + k] > 0 ? (REAL)top : 0) - (wide)width[0];
    }
}

/* Each start is a random plan of sides that last, improved by the adjoint of the run before. */
void attack(const setup *s, long sequences, long steps, unsigned long long seed, result *found)
{
    moment *plan = malloc((size_t)steps * sizeof *plan);
    pair now;
    wide toward[N + 2];
    random_state = seed * 2654435761u + 88172645463325252u;
    for (long k = 0; k < sequences; k++) {
        int turn = (int)(k % ROUNDS), sign = k / ROUNDS % 2 ? 1 : -1;
        if (turn == 0) {
            double longest = log((double)steps), dwell = 0;
            int side = 1;
            memset(plan, 0, (size_t)steps * sizeof *plan);
            for (long t = 0; t < steps; t++) {
                if (dwell-- <= 0) side = (int)uniform(0, 4) - 1, dwell = exp(uniform(0, longest));
                plan[t].side = (signed char)side;
                plan[t].noise = uniform(-1, 1) < 0 ? -1 : 1;
                plan[t].push = uniform(-1, 1) < 0 ? -1 : 1;
            }
            for (int i = 0; i < 2; i++) toward[N + i] = uniform(-1, 1);
        }
        begin_widths(s, &now, toward);
        if (run_plan(s, plan, steps, &now, found) < steps) continue;
        improve_plan(s, plan, steps, sign, turn % 4 == 3 ? 0 : uniform(0, 1), toward);
    }
    free(plan);
}
