/* Sequences of sides, readings and disturbances against the C of an observer, beside its plant.
   The plant runs in long double. Before each step plant and estimate move by the same vector, so
   that any side may follow any other: the error stays, and the theorem does not depend on it. */
#include "observer.h"
#include <math.h>
#include <string.h>

typedef long double wide;
typedef struct { wide x[N]; wide right, left; observer_state memory; } pair; /* x: the error */
typedef struct {
    double phi[2][N * N], psi[2][N], c[N], x[N], p[N * N];
    double slope, threshold, widest, noise, push, u, r, v, radius, width;
} setup;
typedef struct { double seen, fullest, width; long left; } result;

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

static wide storage(const setup *s, const pair *now)
{
    wide v = 0, r = now->right - now->memory.right[0], l = now->left - now->memory.left[0];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) v += s->p[i * N + j] * now->x[i] * now->x[j];
    return v + s->r * (r * r + l * l);
}

/* One step on a side: 1, -1, 0, or 2 without a reading. `noise` and `push` are in [-1, 1]. */
static void advance_pair(const setup *s, pair *now, int side, double noise, double push)
{
    wide x[N], next[N], most = 0, part, z, edge = side == -1 ? -now->left : now->right;
    observer_in in;
    observer_out out;
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)uniform(-0.3 * s->x[i], 0.3 * s->x[i]);
        x[i] = now->memory.x[i] + now->x[i];
        most += fabs(s->c[i]) * s->x[i];
    }
    wide far = s->threshold + 1.01 * s->noise;
    z = side == 1 || side == -1 ? edge + side * (far / s->slope + uniform(1e-3, 0.1) * most)
                                : uniform(-(double)now->left, (double)now->right);
    part = (z - output(s, x)) / most;
    for (int i = 0; i < N; i++) {
        now->memory.x[i] = (REAL)(now->memory.x[i] + part * copysign(s->x[i], s->c[i]));
        x[i] = now->memory.x[i] + now->x[i];
        if (fabsl(x[i]) > s->x[i]) return; /* beyond the plant's range: not this step */
    }
    z = output(s, x);
    wide y = z > now->right ? z - now->right : z < -now->left ? z + now->left : 0;
    if (side == 1 && y <= 0) return;
    if (side == -1 && y >= 0) return;
    if (side == 0 && fabsl(y) * s->slope + s->noise > s->threshold) noise = 0;
    y = s->slope * y + (1 - 1e-3) * s->noise * noise;
    in.y[0] = side == 2 ? NAN : (REAL)y;
    in.u[0] = (REAL)uniform(-s->u, s->u);
    for (int i = 0; i < N; i++) {
        next[i] = ((wide)s->psi[0][i] + s->psi[1][i]) * (in.u[0] + s->push * push);
        for (int j = 0; j < N; j++)
            next[i] += ((wide)s->phi[0][i * N + j] + s->phi[1][i * N + j]) * x[j];
    }
    observer_step(&now->memory, &in, &out);
    for (int i = 0; i < N; i++) now->x[i] = next[i] - now->memory.x[i];
}

static double pick_end(double top)
{
    double share = uniform(0, 3);
    return share < 1 ? 0 : share < 2 ? top : uniform(0, top);
}

/* Runs sequences of `steps`; `signs` are the worst ones of noise and push for a branch that stays.*/
void attack(const setup *s, long sequences, long steps, int known, const double *signs,
            unsigned long long seed, result *found)
{
    random_state = seed * 2654435761u + 88172645463325252u;
    for (long k = 0; k < sequences; k++) {
        pair now, best, trial;
        int policy = (int)(k % 6), side = 1, dwell = 0, flip = k % 12 < 6 ? 1 : -1;
        long period = 1 + (long)uniform(0, (double)steps / 2);
        observer_init(&now.memory);
        memset(now.x, 0, sizeof now.x);
        now.memory.right[0] = (REAL)pick_end(s->widest);
        now.memory.left[0] = (REAL)pick_end(s->widest);
        now.right = known ? now.memory.right[0] : (REAL)pick_end(s->widest);
        now.left = known ? now.memory.left[0] : (REAL)pick_end(s->widest);
        for (long t = 0; t < steps; t++) {
            double noise = flip * signs[2 * t], push = flip * signs[2 * t + 1];
            if (policy == 0) {
                if (dwell-- <= 0) {
                    side = (int)uniform(0, 4) - 1;
                    dwell = (int)exp(uniform(0, 6));
                }
                advance_pair(s, &now, side, uniform(-1, 1), uniform(-1, 1));
            } else if (policy <= 2) {
                advance_pair(s, &now, policy == 1 ? 1 : -1, noise, push);
            } else if (policy == 5) {
                advance_pair(s, &now, t / period % 2 ? -1 : 1, noise, push);
            } else {
                wide highest = -1;
                for (int choice = 0; choice < 8; choice++) {
                    trial = now;
                    advance_pair(s, &trial, choice / 2 - 1, choice % 2 ? 1 : -1,
                                 policy == 3 ? flip : choice % 2 ? 1 : -1);
                    wide size = policy == 3 ? fabsl(output(s, trial.x)) : storage(s, &trial);
                    if (size > highest) highest = size, best = trial;
                }
                now = best;
            }
            wide v = storage(s, &now), z = fabsl(output(s, now.x));
            wide d = fmaxl(fabsl(now.right - now.memory.right[0]), fabsl(now.left - now.memory.left[0]));
            found->seen = fmax(found->seen, (double)z);
            found->fullest = fmax(found->fullest, (double)(v / s->v));
            found->width = fmax(found->width, (double)d);
            if (v > s->v || z > s->radius || d > s->width) {
                found->left++;
                break;
            }
        }
    }
}
