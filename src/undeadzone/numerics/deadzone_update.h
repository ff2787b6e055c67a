/* deadzone_update.h: `uz.deadzone_update` in C: the measurement update through a dead zone for any
   Kalman filter.

   x has n states, two of which may be the widths d_r and d_l; P is their covariance, row by row.
   Define DEADZONE_REAL as double before this file for double precision. No memory is allocated. */
#ifndef DEADZONE_UPDATE_H
#define DEADZONE_UPDATE_H
#include <math.h>
#ifndef DEADZONE_REAL
#define DEADZONE_REAL float
#endif
typedef DEADZONE_REAL deadzone_real;

/* In place of a side: a number of x, P or C is not finite, or P is no covariance. */
#define DEADZONE_INVALID 2

/* State from one reading to the next; all 0 at first. */
typedef struct {
  deadzone_real last, previous; /* readings, 0 if it was missing */
  int wait[2];                  /* readings until the right, the left edge is used again */
} DeadzoneMemory;

typedef struct {
  const deadzone_real *C;     /* row that reads z from x (n) */
  int at[2];                  /* places of d_r and d_l in x; -1: the width is known */
  deadzone_real width[2];     /* the widths that are known; INFINITY: no such edge */
  deadzone_real noise;        /* rms behind the zone [y]; with noise_before it must not be 0 */
  deadzone_real noise_before; /* rms ahead of it [z] */
  deadzone_real slope;        /* of the branches [y/z] */
  int rest;                   /* readings for which an edge is not used again */
} DeadzoneSensor;

/* The sensor's shape, all 0 of an exact one: a gate as wide as its edges are round, and how far x
   would move per error of the slope, of a reading at its edge [z] and of its time [samples]. Your
   prediction moves each column as it moves x. To show P, add var S S' of each column: of the
   slope's relative deviation, of 1.15 rounding, and of the delay's in samples. */
typedef struct {
  deadzone_real rounding; /* how far about an edge the characteristic is round [z] */
  deadzone_real ahead;    /* predicted change of z in the last sample [z] */
  deadzone_real *columns; /* 3 columns of n, one after the other; 0: none are kept */
} DeadzoneShape;

static deadzone_real deadzone_hazard(deadzone_real a) {
  if (a > -5)
    return (deadzone_real)(exp(-0.5 * a * a) /
                           (1.2533141373155003 * (1 + erf(a * 0.7071067811865476))));
  return -a + (1 - (2 - 10 / (a * a)) / (a * a)) / -a;
}

/* k = P h with h = sign C - row of the width; returns h x */
static deadzone_real deadzone_row(const DeadzoneSensor *s, int n, const deadzone_real *x,
                                  const deadzone_real *P, int edge, deadzone_real sign,
                                  deadzone_real of_width, deadzone_real *k) {
  deadzone_real expected = 0;
  for (int r = 0; r < n; r++) {
    k[r] = s->at[edge] < 0 ? 0 : of_width * P[r * n + s->at[edge]];
    for (int c = 0; c < n; c++) k[r] += sign * s->C[c] * P[r * n + c];
    expected += sign * s->C[r] * x[r];
  }
  return expected + (s->at[edge] < 0 ? 0 : of_width * x[s->at[edge]]);
}

/* h k, with the same h */
static deadzone_real deadzone_along(const DeadzoneSensor *s, int n, int edge, deadzone_real sign,
                                    deadzone_real of_width, const deadzone_real *k) {
  deadzone_real sum = s->at[edge] < 0 ? 0 : of_width * k[s->at[edge]];
  for (int c = 0; c < n; c++) sum += sign * s->C[c] * k[c];
  return sum;
}

static int deadzone_is_certain(deadzone_real y, deadzone_real last, deadzone_real previous,
                               deadzone_real gate) {
  return y > 2 * gate || (last > gate && previous > gate && 2 * last - previous > gate && y > 0);
}

/* Whether the estimate loses at most all its variance, and not less than 0, in any direction: from
   the larger variance and what the other edge has besides, as of edges that are nearly one the
   large parts cancel. */
static int deadzone_are_moments(const deadzone_real pull[2], const deadzone_real bend[2],
                                const deadzone_real G[3]) {
  int i = G[0] >= G[2] ? 0 : 1;
  deadzone_real most = G[2 * i], least = G[2 - 2 * i], area = most * least - G[1] * G[1], trace,
                det;
  deadzone_real together = pull[i] * most + pull[1 - i] * G[1];
  if (area < (deadzone_real)(sizeof(deadzone_real) > 4 ? 1e-12 : 1e-5) * most * least) area = 0;
  trace = most > 0 ? (together * together + pull[1 - i] * pull[1 - i] * area) / most : 0;
  trace += bend[i] * most + bend[1 - i] * least;
  det = area * (pull[0] * pull[0] * bend[1] + pull[1] * pull[1] * bend[0] + bend[0] * bend[1]);
  return 0 < trace && trace < 2 && 1 - trace + det > 0 && det > (deadzone_real)-1e-6;
}

/* The columns after a reading y [z] on the side of edge j: S + k (phi - h S) / var. */
static inline void deadzone_move_columns(const DeadzoneSensor *s, const DeadzoneShape *shape, int n,
                                         int j, deadzone_real y, const deadzone_real *k,
                                         deadzone_real var) {
  deadzone_real side = j ? -1 : 1, phi[3] = {y, 0, -shape->ahead}, far = y < 0 ? -y : y;
  if (shape->rounding > 0) {
    far /= (deadzone_real)1.4 * shape->rounding;
    phi[1] = side * (deadzone_real)exp(-(far < 30 ? far : 30));
  }
  for (int i = 0; i < 3; i++) {
    deadzone_real *S = shape->columns + i * n;
    deadzone_real off = phi[i] - deadzone_along(s, n, j, 1, -side, S);
    for (int r = 0; r < n; r++) S[r] += k[r] * off / var;
  }
}

/* Whether all is finite and no two states are related by more than their deviations allow. */
static int deadzone_is_estimate(int n, const deadzone_real *C, const deadzone_real *x,
                                const deadzone_real *P) {
  for (int r = 0; r < n; r++) {
    if (!isfinite(x[r]) || !isfinite(C[r]) || !(P[r * n + r] >= 0)) return 0;
    for (int c = 0; c < n; c++) {
      double most = sqrt((double)P[r * n + r]) * sqrt((double)P[c * n + c]);
      if (!isfinite(P[r * n + c]) || fabs((double)P[r * n + c]) > 1.001 * most) return 0;
    }
  }
  return 1;
}

/* `deadzone_update` for a sensor with a shape, whose columns move as x does. */
static inline int deadzone_update_shape(DeadzoneMemory *memory, const DeadzoneSensor *s,
                                        const DeadzoneShape *shape, int n, deadzone_real *x,
                                        deadzone_real *P, deadzone_real y, deadzone_real *work) {
  deadzone_real *k[2] = {work, work + n}, gate = 4 * s->noise, behind = s->noise / s->slope;
  if (shape->rounding * s->slope > gate) gate = shape->rounding * s->slope;
  deadzone_real R = behind * behind + s->noise_before * s->noise_before, last = memory->last;
  deadzone_real previous = memory->previous;
  if (!deadzone_is_estimate(n, s->C, x, P)) return DEADZONE_INVALID;
  int waits[2] = {memory->wait[0], memory->wait[1]}, side;
  for (int i = 0; i < 2; i++) memory->wait[i] = waits[i] > 0 ? waits[i] - 1 : 0;
  memory->previous = last;
  memory->last = isfinite(y) ? y : 0;
  if (!isfinite(y)) return 0;
  side = deadzone_is_certain(y, last, previous, gate) -
         deadzone_is_certain(-y, -last, -previous, gate);
  if (side && s->at[side < 0] < 0 && isinf(s->width[side < 0])) side = 0;
  if (side) {
    int j = side < 0;
    deadzone_real e = y / s->slope + (s->at[j] < 0 ? side * s->width[j] : 0);
    e -= deadzone_row(s, n, x, P, j, 1, (deadzone_real)-side, k[0]);
    deadzone_real S = deadzone_along(s, n, j, 1, (deadzone_real)-side, k[0]) + R;
    if (!(S > 0)) return DEADZONE_INVALID;
    if (shape->columns) deadzone_move_columns(s, shape, n, j, y / s->slope, k[0], S);
    for (int r = 0; r < n; r++) {
      x[r] += k[0][r] * e / S;
      for (int c = 0; c < n; c++) P[r * n + c] -= k[0][r] * k[0][c] / S;
    }
  }
  if (fabs((double)y) > gate) return side;
  deadzone_real G[3], std[2], a[2], inside[2], slope[2] = {0, 0}, both[2], pull[2], bend[2];
  int used[2], unsure = 1;
  for (int i = 0; i < 2; i++) {
    deadzone_real sign = i ? -1 : 1, bound = gate / s->slope + (s->at[i] < 0 ? s->width[i] : 0);
    deadzone_real short_of = bound - deadzone_row(s, n, x, P, i, sign, -1, k[i]);
    G[2 * i] = deadzone_along(s, n, i, sign, -1, k[i]);
    if (!(G[2 * i] + R > 0)) return DEADZONE_INVALID;
    std[i] = (deadzone_real)sqrt(G[2 * i] + R);
    a[i] = short_of / std[i] < -30 ? -30 : short_of / std[i];
    a[i] = a[i] > 30 ? 30 : a[i];
    inside[i] = (deadzone_real)((1 + erf(a[i] * 0.7071067811865476)) / 2);
    used[i] = waits[i] <= 0 && a[i] < (deadzone_real)1.6448536269514722;
  }
  if (!used[0] && !used[1]) return side;
  G[1] = deadzone_along(s, n, 0, 1, -1, k[1]);
  int nearest = used[0] && (!used[1] || a[0] <= a[1]) ? 0 : 1;
  slope[nearest] = deadzone_hazard(a[nearest]);
  for (int i = 0; i < 2; i++)
    unsure =
        unsure && waits[i] <= 0 && a[i] > -5 && 1 - inside[i] > (deadzone_real)0.05 * inside[1 - i];
  if (unsure) {
    deadzone_real left = inside[0] + inside[1] - 1;
    if (left < (deadzone_real)1e-6) left = (deadzone_real)1e-6;
    for (int i = 0; i < 2; i++)
      both[i] = (deadzone_real)(exp(-0.5 * a[i] * a[i]) * 0.3989422804014327) / left;
    for (int i = 0; i < 2; i++) pull[i] = both[i] / std[i], bend[i] = pull[i] * a[i] / std[i];
    if (deadzone_are_moments(pull, bend, G)) slope[0] = both[0], slope[1] = both[1];
  }
  for (int i = 0; i < 2; i++) pull[i] = slope[i] / std[i], bend[i] = pull[i] * a[i] / std[i];
  for (int r = 0; r < n; r++) {
    deadzone_real shift = k[0][r] * pull[0] + k[1][r] * pull[1];
    x[r] -= shift;
    for (int c = 0; c < n; c++)
      P[r * n + c] -= shift * (k[0][c] * pull[0] + k[1][c] * pull[1]) +
                      bend[0] * k[0][r] * k[0][c] + bend[1] * k[1][r] * k[1][c];
  }
  for (int i = 0; i < 2; i++)
    if (slope[i] > 0) memory->wait[i] = s->rest;
  return side;
}

/* Update x and P by one reading y (NAN: missing). Returns the side that was read, 0 if none is
   certain, DEADZONE_INVALID if x, P or C is not valid: restart the filter then. work: 2 n numbers.
 */
static inline int deadzone_update(DeadzoneMemory *memory, const DeadzoneSensor *s, int n,
                                  deadzone_real *x, deadzone_real *P, deadzone_real y,
                                  deadzone_real *work) {
  DeadzoneShape exact = {0, 0, 0};
  return deadzone_update_shape(memory, s, &exact, n, x, P, y, work);
}
#endif
