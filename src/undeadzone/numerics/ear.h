/* ear.h: `uz.deadzone_update` in C: a reading of a sensor with a dead zone into anybody's Kalman filter.

   x has n states, two of which may be the widths d_r and d_l; P is their covariance, row by row.
   Define EAR_REAL as double before this file for double precision. No memory is allocated. */
#ifndef EAR_H
#define EAR_H
#include <math.h>
#ifndef EAR_REAL
#define EAR_REAL float
#endif
typedef EAR_REAL ear_real;

/* In place of a side: a number of x, P or C is not finite, or P is no covariance. */
#define EAR_REFUSED 2

/* What is kept between readings; all 0 at first. */
typedef struct {
  ear_real last, previous; /* readings, 0 where one was missing */
  int wait[2];             /* readings until the right, the left edge is heard again */
} Ear;

typedef struct {
  const ear_real *C;     /* row that reads z from x (n) */
  int at[2];             /* places of d_r and d_l in x; -1: the width is known */
  ear_real width[2];     /* the widths that are known; INFINITY: no such edge */
  ear_real noise;        /* rms behind the zone [y]; with noise_before it must not be 0 */
  ear_real noise_before; /* rms ahead of it [z] */
  ear_real slope;        /* of the branches [y/z] */
  int rest;              /* readings for which an edge is not heard again */
} EarSensor;

/* The sensor's shape, all 0 of an exact one: a gate as wide as its edges are round, and how far x
   would move per error of the slope, of a reading at its edge [z] and of its time [samples]. Your
   prediction moves each column as it moves x. To show P, add var S S' of each column: of the slope's
   relative deviation, of 1.15 rounding, and of the delay's in samples. */
typedef struct {
  ear_real rounding; /* how far about an edge the characteristic is round [z] */
  ear_real ahead;    /* by how much z was foretold to move in the last sample [z] */
  ear_real *columns; /* 3 columns of n, one after the other; 0: none are kept */
} EarShape;

static ear_real ear_hazard(ear_real a) {
  if (a > -5)
    return (ear_real)(exp(-0.5 * a * a) / (1.2533141373155003 * (1 + erf(a * 0.7071067811865476))));
  return -a + (1 - (2 - 10 / (a * a)) / (a * a)) / -a;
}

/* k = P h with h = sign C - row of the width; returns h x */
static ear_real ear_row(const EarSensor *s, int n, const ear_real *x, const ear_real *P, int edge,
                        ear_real sign, ear_real of_width, ear_real *k) {
  ear_real expected = 0;
  for (int r = 0; r < n; r++) {
    k[r] = s->at[edge] < 0 ? 0 : of_width * P[r * n + s->at[edge]];
    for (int c = 0; c < n; c++) k[r] += sign * s->C[c] * P[r * n + c];
    expected += sign * s->C[r] * x[r];
  }
  return expected + (s->at[edge] < 0 ? 0 : of_width * x[s->at[edge]]);
}

/* h k, with the same h */
static ear_real ear_along(const EarSensor *s, int n, int edge, ear_real sign, ear_real of_width,
                          const ear_real *k) {
  ear_real sum = s->at[edge] < 0 ? 0 : of_width * k[s->at[edge]];
  for (int c = 0; c < n; c++) sum += sign * s->C[c] * k[c];
  return sum;
}

static int ear_sure(ear_real y, ear_real last, ear_real previous, ear_real gate) {
  return y > 2 * gate || (last > gate && previous > gate && 2 * last - previous > gate && y > 0);
}

/* Whether the belief loses no more than all, and no less than nothing, in any direction: from the
   larger variance and what the other edge has besides, as of edges that are nearly one the large
   parts cancel. */
static int ear_moments(const ear_real pull[2], const ear_real bend[2], const ear_real G[3]) {
  int i = G[0] >= G[2] ? 0 : 1;
  ear_real most = G[2 * i], least = G[2 - 2 * i], area = most * least - G[1] * G[1], trace, det;
  ear_real together = pull[i] * most + pull[1 - i] * G[1];
  if (area < (ear_real)(sizeof(ear_real) > 4 ? 1e-12 : 1e-5) * most * least) area = 0;
  trace = most > 0 ? (together * together + pull[1 - i] * pull[1 - i] * area) / most : 0;
  trace += bend[i] * most + bend[1 - i] * least;
  det = area * (pull[0] * pull[0] * bend[1] + pull[1] * pull[1] * bend[0] + bend[0] * bend[1]);
  return 0 < trace && trace < 2 && 1 - trace + det > 0 && det > (ear_real)-1e-6;
}

/* The columns after a reading y [z] on the side of edge j: S + k (phi - h S) / var. */
static inline void ear_move_columns(const EarSensor *s, const EarShape *shape, int n, int j,
                                    ear_real y, const ear_real *k, ear_real var) {
  ear_real side = j ? -1 : 1, phi[3] = {y, 0, -shape->ahead}, far = y < 0 ? -y : y;
  if (shape->rounding > 0) {
    far /= (ear_real)1.4 * shape->rounding;
    phi[1] = side * (ear_real)exp(-(far < 30 ? far : 30));
  }
  for (int i = 0; i < 3; i++) {
    ear_real *S = shape->columns + i * n;
    ear_real off = phi[i] - ear_along(s, n, j, 1, -side, S);
    for (int r = 0; r < n; r++) S[r] += k[r] * off / var;
  }
}

/* Whether all is finite and no two states are related by more than their deviations allow. */
static int ear_is_belief(int n, const ear_real *C, const ear_real *x, const ear_real *P) {
  for (int r = 0; r < n; r++) {
    if (!isfinite(x[r]) || !isfinite(C[r]) || !(P[r * n + r] >= 0)) return 0;
    for (int c = 0; c < n; c++) {
      double most = sqrt((double)P[r * n + r]) * sqrt((double)P[c * n + c]);
      if (!isfinite(P[r * n + c]) || fabs((double)P[r * n + c]) > 1.001 * most) return 0;
    }
  }
  return 1;
}

/* `ear_hear` of a sensor with a shape, whose columns move as x does. */
static inline int ear_hear_shape(Ear *ear, const EarSensor *s, const EarShape *shape, int n,
                                 ear_real *x, ear_real *P, ear_real y, ear_real *work) {
  ear_real *k[2] = {work, work + n}, gate = 4 * s->noise, behind = s->noise / s->slope;
  if (shape->rounding * s->slope > gate) gate = shape->rounding * s->slope;
  ear_real R = behind * behind + s->noise_before * s->noise_before, last = ear->last;
  ear_real previous = ear->previous;
  if (!ear_is_belief(n, s->C, x, P)) return EAR_REFUSED;
  int waits[2] = {ear->wait[0], ear->wait[1]}, side;
  for (int i = 0; i < 2; i++) ear->wait[i] = waits[i] > 0 ? waits[i] - 1 : 0;
  ear->previous = last;
  ear->last = isfinite(y) ? y : 0;
  if (!isfinite(y)) return 0;
  side = ear_sure(y, last, previous, gate) - ear_sure(-y, -last, -previous, gate);
  if (side && s->at[side < 0] < 0 && isinf(s->width[side < 0])) side = 0;
  if (side) {
    int j = side < 0;
    ear_real e = y / s->slope + (s->at[j] < 0 ? side * s->width[j] : 0);
    e -= ear_row(s, n, x, P, j, 1, (ear_real)-side, k[0]);
    ear_real S = ear_along(s, n, j, 1, (ear_real)-side, k[0]) + R;
    if (!(S > 0)) return EAR_REFUSED;
    if (shape->columns) ear_move_columns(s, shape, n, j, y / s->slope, k[0], S);
    for (int r = 0; r < n; r++) {
      x[r] += k[0][r] * e / S;
      for (int c = 0; c < n; c++) P[r * n + c] -= k[0][r] * k[0][c] / S;
    }
  }
  if (fabs((double)y) > gate) return side;
  ear_real G[3], std[2], a[2], inside[2], slope[2] = {0, 0}, both[2], pull[2], bend[2];
  int heard[2], unsure = 1;
  for (int i = 0; i < 2; i++) {
    ear_real sign = i ? -1 : 1, bound = gate / s->slope + (s->at[i] < 0 ? s->width[i] : 0);
    ear_real short_of = bound - ear_row(s, n, x, P, i, sign, -1, k[i]);
    G[2 * i] = ear_along(s, n, i, sign, -1, k[i]);
    if (!(G[2 * i] + R > 0)) return EAR_REFUSED;
    std[i] = (ear_real)sqrt(G[2 * i] + R);
    a[i] = short_of / std[i] < -30 ? -30 : short_of / std[i];
    a[i] = a[i] > 30 ? 30 : a[i];
    inside[i] = (ear_real)((1 + erf(a[i] * 0.7071067811865476)) / 2);
    heard[i] = waits[i] <= 0 && a[i] < (ear_real)1.6448536269514722;
  }
  if (!heard[0] && !heard[1]) return side;
  G[1] = ear_along(s, n, 0, 1, -1, k[1]);
  int nearest = heard[0] && (!heard[1] || a[0] <= a[1]) ? 0 : 1;
  slope[nearest] = ear_hazard(a[nearest]);
  for (int i = 0; i < 2; i++)
    unsure = unsure && waits[i] <= 0 && a[i] > -5 &&
             1 - inside[i] > (ear_real)0.05 * inside[1 - i];
  if (unsure) {
    ear_real left = inside[0] + inside[1] - 1;
    if (left < (ear_real)1e-6) left = (ear_real)1e-6;
    for (int i = 0; i < 2; i++)
      both[i] = (ear_real)(exp(-0.5 * a[i] * a[i]) * 0.3989422804014327) / left;
    for (int i = 0; i < 2; i++) pull[i] = both[i] / std[i], bend[i] = pull[i] * a[i] / std[i];
    if (ear_moments(pull, bend, G)) slope[0] = both[0], slope[1] = both[1];
  }
  for (int i = 0; i < 2; i++) pull[i] = slope[i] / std[i], bend[i] = pull[i] * a[i] / std[i];
  for (int r = 0; r < n; r++) {
    ear_real shift = k[0][r] * pull[0] + k[1][r] * pull[1];
    x[r] -= shift;
    for (int c = 0; c < n; c++)
      P[r * n + c] -= shift * (k[0][c] * pull[0] + k[1][c] * pull[1]) +
                      bend[0] * k[0][r] * k[0][c] + bend[1] * k[1][r] * k[1][c];
  }
  for (int i = 0; i < 2; i++)
    if (slope[i] > 0) ear->wait[i] = s->rest;
  return side;
}

/* One reading; NAN: missing. Moves x and P; returns the side that was read, 0 where none was sure,
   EAR_REFUSED where x, P or C cannot be: begin anew then. work: 2 n numbers. */
static inline int ear_hear(Ear *ear, const EarSensor *s, int n, ear_real *x, ear_real *P,
                           ear_real y, ear_real *work) {
  EarShape exact = {0, 0, 0};
  return ear_hear_shape(ear, s, &exact, n, x, P, y, work);
}
#endif
