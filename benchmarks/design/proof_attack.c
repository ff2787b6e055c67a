/* Sequences of sides, readings and disturbances against the C of an observer, beside its plant.
   The plant runs in long double. Before each step plant and estimate move by the same vector, so
   that any side may follow any other: the error stays, and the theorem does not depend on it. */
#include "observer.h"
#include <math.h>
#include <string.h>

typedef long double wide;
typedef struct { wide e[N + 2]; observer_state memory; } pair; /* errors: of x, right, left */
typedef struct {
    double phi[N * (N + 1)], c[N], x[N], s[(N + 2) * (N + 2)];
    double slope, threshold, widest, noise, push, u, radius;
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

/* One step on a side: 1, -1, 0, or 2 without a reading. `noise` and `push` are in [-1, 1]. */
static void advance_pair(const setup *s, pair *now, int side, double noise, double push)
{
    wide x[N], next[N], most = 0, part, z, right, left;
    observer_in in;
    observer_out out;
    right = now->e[N] + now->memory.right[0];
    left = now->e[N + 1] + now->memory.left[0];
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)uniform(-0.3 * s->x[i], 0.3 * s->x[i]);
        x[i] = now->memory.x[i] + now->e[i];
        most += fabs(s->c[i]) * s->x[i];
    }
    wide far = (s->threshold + 1.01 * s->noise) / s->slope + uniform(1e-3, 0.1) * most;
    z = side == 1 ? right + far : side == -1 ? -left - far : uniform((double)-left, (double)right);
    part = (z - output(s, x)) / most;
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)(now->memory.x[i] + part * copysign(s->x[i], s->c[i]));
        x[i] = now->memory.x[i] + now->e[i];
        if (fabsl(x[i]) > s->x[i]) return; /* beyond the plant's range: not this step */
    }
    z = output(s, x);
    wide y = z > right ? z - right : z < -left ? z + left : 0;
    if ((side == 1 && y <= 0) || (side == -1 && y >= 0)) return;
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
}

static double pick_end(double top)
{
    double share = uniform(0, 3);
    return share < 1 ? 0 : share < 2 ? top : uniform(0, top);
}

/* Every fourth sequence is random. Of the others each step is the worst of all, or of one side that
   changes from time to time, by |z - z^| or by V. */
void attack(const setup *s, long sequences, long steps, unsigned long long seed, result *found)
{
    random_state = seed * 2654435761u + 88172645463325252u;
    for (long k = 0; k < sequences; k++) {
        pair now, best, trial;
        int policy = (int)(k % 4), by_output = k % 8 < 4, side = 1, dwell = 0;
        double longest = log((double)steps);
        observer_init(&now.memory);
        memset(now.e, 0, sizeof now.e);
        now.memory.right[0] = (REAL)pick_end(s->widest);
        now.memory.left[0] = (REAL)pick_end(s->widest);
        now.e[N] = (REAL)pick_end(s->widest) - (wide)now.memory.right[0];
        now.e[N + 1] = (REAL)pick_end(s->widest) - (wide)now.memory.left[0];
        for (long t = 0; t < steps; t++) {
            if (dwell-- <= 0) {
                side = policy == 1 ? -side : (int)uniform(0, 4) - 1;
                dwell = (int)exp(uniform(0, longest));
            }
            if (policy == 0) {
                advance_pair(s, &now, side, uniform(-1, 1), uniform(-1, 1));
            } else {
                wide highest = -1;
                for (int choice = 0; choice < 16; choice++) {
                    int own = policy == 3 ? choice / 4 - 1 : side;
                    if (policy != 3 && choice > 3) break;
                    trial = now;
                    advance_pair(s, &trial, own, choice % 2 ? 1 : -1, choice / 2 % 2 ? 1 : -1);
                    wide size = by_output ? fabsl(output(s, trial.e)) : storage(s, &trial);
                    if (size > highest) highest = size, best = trial;
                }
                now = best;
            }
            double v = storage(s, &now), z = (double)fabsl(output(s, now.e));
            found->seen = fmax(found->seen, z);
            found->fullest = fmax(found->fullest, v);
            if (v > 1 || z > s->radius) {
                found->left++;
                break;
            }
        }
    }
}
