/* The loop by hand, for N states: time outermost, W lanes innermost (W = 1: one trajectory at a time).
   STEP is plain (RK4, the sensor's side taken at each stage), located (the change of side found inside the step) or sampled.
   KNOWN: the numbers of a Loop, where they are known to the compiler. V is a vector of VL lanes, M a mask of as many. */
#include <stdint.h>
#include <stdlib.h>

#if W == 1
#define VL 1
typedef double V;
typedef int M;
#define NOT(m) (!(m))
#define ABOVE(a, b) ((a) > (b))
#define SELECT(m, a, b) ((m) ? (a) : (b))
#define ANY(m) (m)
#elif defined __AVX512F__
#include <immintrin.h>
#define VL 8
typedef __m512d V;
typedef __mmask8 M;
#define NOT(m) ((M) ~(m))
#define ABOVE(a, b) _mm512_cmp_pd_mask(a, b, _CMP_GT_OQ)
#define SELECT(m, a, b) _mm512_mask_blend_pd(m, b, a)
#define LEAST _mm512_min_pd
#define MOST _mm512_max_pd
#define ANY(m) (m)
#else
#ifdef __AVX__
#define VL 4
#else
#define VL 2
#endif
typedef double V __attribute__((vector_size(8 * VL)));
typedef int64_t M __attribute__((vector_size(8 * VL)));
#define NOT(m) (~(m))
#define ABOVE(a, b) ((a) > (b))
#define SELECT(m, a, b) ((V)(((M)(a) & (m)) | ((M)(b) & ~(m))))
static inline int ANY(M m) {
    int64_t found = 0;
    for (int i = 0; i < VL; i++) found |= m[i];
    return found != 0;
}
#endif
#ifndef LEAST
#define LEAST(a, b) SELECT(ABOVE(b, a), a, b)
#define MOST(a, b) SELECT(ABOVE(a, b), a, b)
#endif
#define S (2 * N + 2)
#define G (W / VL)
#define ALL(a) ((a) - (V){0})
#define EACH(i, n) _Pragma("GCC unroll 32") for (int i = 0; i < (n); i++)
#define INLINE static inline __attribute__((always_inline))

typedef struct {
    double A[N][N], B[N], C[N];                        /* the plant */
    double Am[N][N], Bm[N], Cm[N], L[N], gamma, limit; /* the observer */
    double K[N], h;                                    /* the controller, the step */
} Loop;

typedef struct { V right, left; } Widths;
typedef struct { M right, left; } Side;
typedef struct { double r, start, middle, end; } Target; /* r, and u_ff + K x_ref at three instants of a step */

INLINE V dot(const double *row, const V *x) {
    V sum = row[0] * x[0];
    EACH(i, N - 1) sum += row[i + 1] * x[i + 1];
    return sum;
}

/* Column by column: the sums do not wait for each other. */
INLINE void times(const double (*A)[N], const V *x, V *out) {
    EACH(i, N) out[i] = A[i][0] * x[0];
    EACH(k, N - 1) EACH(i, N) out[i] += A[i][k + 1] * x[k + 1];
}

INLINE V within(V a, double low, double high) { return MOST(LEAST(a, ALL(high)), ALL(low)); }

INLINE Side side(const Loop *q, const V *s, Widths d) {
    V z = dot(q->C, s);
    return (Side){ABOVE(z, d.right), ABOVE(-d.left, z)};
}

INLINE void project(const Loop *q, V *s) { EACH(i, 2) s[2 * N + i] = within(s[2 * N + i], 0.0, q->limit); }

/* The derivative of s on a side; sampled: its next value, but for the widths, of which it is the change. */
INLINE void move(const Loop *q, const V *s, Side on, Widths d, V v, V *out) {
    V right = within(s[2 * N], 0.0, q->limit), left = within(s[2 * N + 1], 0.0, q->limit);
    V Ax[N], Ax_hat[N], u = v - dot(q->K, s + N), e = dot(q->C, s) - dot(q->Cm, s + N) - SELECT(on.right, d.right - right, left - d.left);
    e = SELECT(on.right | on.left, e, ALL(0.0));
    times(q->A, s, Ax);
    times(q->Am, s + N, Ax_hat);
    EACH(i, N) out[i] = Ax[i] + q->B[i] * u;
    EACH(i, N) out[N + i] = Ax_hat[i] + q->Bm[i] * u + q->L[i] * e;
    out[2 * N] = SELECT(on.right, -q->gamma * e, ALL(0.0));
    out[2 * N + 1] = SELECT(on.left, q->gamma * e, ALL(0.0));
}

/* next = s after h, on one side or (free) on that of each stage. */
INLINE void rk4(const Loop *q, const V *s, Side on, int free, Widths d, V start, V middle, V end, V h, V *next) {
    V k[S], sum[S], t[S];
    move(q, s, on, d, start, k);
    EACH(i, S) sum[i] = k[i], t[i] = s[i] + 0.5 * h * k[i];
    move(q, t, free ? side(q, t, d) : on, d, middle, k);
    EACH(i, S) sum[i] += 2.0 * k[i], t[i] = s[i] + 0.5 * h * k[i];
    move(q, t, free ? side(q, t, d) : on, d, middle, k);
    EACH(i, S) sum[i] += 2.0 * k[i], t[i] = s[i] + h * k[i];
    move(q, t, free ? side(q, t, d) : on, d, end, k);
    EACH(i, S) next[i] = s[i] + h / 6.0 * (sum[i] + k[i]);
}

INLINE M plain(const Loop *q, const V *s, Widths d, const Target *v, V *next) {
    rk4(q, s, side(q, s, d), 1, d, ALL(v->start), ALL(v->middle), ALL(v->end), ALL(q->h), next);
    project(q, next);
    return (M){0};
}

/* The step on the side at its start, and where the side is another at its end. */
INLINE M located(const Loop *q, const V *s, Widths d, const Target *v, V *next) {
    Side on = side(q, s, d);
    rk4(q, s, on, 0, d, ALL(v->start), ALL(v->middle), ALL(v->end), ALL(q->h), next);
    Side then = side(q, next, d);
    project(q, next);
    return (on.right ^ then.right) | (on.left ^ then.left);
}

INLINE V hermite(V x0, V dx0, V x1, V dx1, V h, V c) {
    V d = x1 - x0;
    return x0 + c * (h * dx0 + c * (3.0 * d - h * (2.0 * dx0 + dx1) + c * (h * (dx0 + dx1) - 2.0 * d)));
}

INLINE V hermite_slope(V x0, V dx0, V x1, V dx1, V h, V c) {
    V d = x1 - x0;
    return h * dx0 + c * (2.0 * (3.0 * d - h * (2.0 * dx0 + dx1)) + c * (3.0 * (h * (dx0 + dx1) - 2.0 * d)));
}

/* Where `changed`: the instant of the change on the cubic of z, and RK4 from there on the other side. */
static __attribute__((noinline)) void finish(const Loop *q, const V *s, Widths d, const Target *v, M changed, V *next) {
    V k1[S], k5[S], trial[S], middle[S], h = ALL(q->h);
    Side on = side(q, s, d);
    rk4(q, s, on, 0, d, ALL(v->start), ALL(v->middle), ALL(v->end), h, trial);
    move(q, s, on, d, ALL(v->start), k1);
    move(q, trial, on, d, ALL(v->end), k5);
    V z0 = dot(q->C, s), z1 = dot(q->C, trial), dz0 = dot(q->C, k1), dz1 = dot(q->C, k5);
    M silent = NOT(on.right | on.left), upper = on.right | (silent & ABOVE(z1, d.right));
    V level = SELECT(upper, d.right, -d.left), c = (level - z0) / (z1 - z0);
    for (int i = 0; i < 4; i++) c = within(c - (hermite(z0, dz0, z1, dz1, h, c) - level) / hermite_slope(z0, dz0, z1, dz1, h, c), 0.0, 1.0);
    Side entered = {silent & ABOVE(z1, d.right), silent & ABOVE(-d.left, z1)};
    EACH(i, S) middle[i] = hermite(s[i], k1[i], trial[i], k5[i], h, c);
    V rest = 1.0 - c, half = c + 0.5 * rest, bend = ALL(2.0 * (v->start + v->end) - 4.0 * v->middle), slope = ALL(4.0 * v->middle - 3.0 * v->start - v->end);
    rk4(q, middle, entered, 0, d, v->start + c * (slope + c * bend), v->start + half * (slope + half * bend), ALL(v->end), h * rest, trial);
    project(q, trial);
    EACH(i, S) next[i] = SELECT(changed, trial[i], next[i]);
}

INLINE M sampled(const Loop *q, const V *s, Widths d, const Target *v, V *next) {
    move(q, s, side(q, s, d), d, ALL(v->start), next);
    EACH(i, 2) next[2 * N + i] += s[2 * N + i];
    project(q, next);
    return (M){0};
}

/* W lanes from `first` on, places beyond the last lane repeating it; sum: of (z - r)^2 from step `from` on. */
static void block(const Loop *q, long steps, long from, const Target *targets, long first, long lanes, double *states, const double *widths, double *sums) {
#ifdef KNOWN
    static const Loop known = {KNOWN};
    q = &known;
#endif
    V now[G][S], then[G][S], sum[G], d[G][2];
    M changed[G];
    V(*s)[S] = now, (*next)[S] = then;
    for (int j = 0; j < W; j++) {
        long lane = first + j < lanes ? first + j : lanes - 1;
        for (int i = 0; i < S; i++) ((double *)s[j / VL])[i * VL + j % VL] = states[lane * S + i];
        for (int i = 0; i < 2; i++) ((double *)d[j / VL])[i * VL + j % VL] = widths[lane * 2 + i];
    }
    for (int g = 0; g < G; g++) sum[g] = ALL(0.0);
    for (long k = 0; k < steps; k++) {
        const Target *v = &targets[k];
        M some = {0};
        for (int g = 0; g < G; g++) {
            if (k >= from) {
                V error = dot(q->C, s[g]) - v->r;
                sum[g] += error * error;
            }
            changed[g] = STEP(q, s[g], (Widths){d[g][0], d[g][1]}, v, next[g]);
            some |= changed[g];
        }
        if (__builtin_expect(ANY(some), 0))
            for (int g = 0; g < G; g++)
                if (ANY(changed[g])) finish(q, s[g], (Widths){d[g][0], d[g][1]}, v, changed[g], next[g]);
        V(*swap)[S] = s;
        s = next, next = swap;
    }
    for (int j = 0; j < W && first + j < lanes; j++) {
        for (int i = 0; i < S; i++) states[(first + j) * S + i] = ((double *)s[j / VL])[i * VL + j % VL];
        sums[first + j] = ((double *)sum)[j];
    }
}

/* targets: (steps x 3 x (1 + N + 1)) of r, x_ref, u_ff; states (lanes x S) are replaced by the final ones. */
void run(const Loop *q, long steps, long from, const double *targets, long lanes, double *states, const double *widths, double *sums, int threads) {
    Target *v = malloc(steps * sizeof *v);
    for (long k = 0; k < steps; k++) {
        double at[3];
        for (int c = 0; c < 3; c++) {
            const double *one = targets + (k * 3 + c) * (N + 2);
            at[c] = one[N + 1];
            for (int i = 0; i < N; i++) at[c] += q->K[i] * one[1 + i];
        }
        v[k] = (Target){targets[k * 3 * (N + 2)], at[0], at[1], at[2]};
    }
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (long first = 0; first < lanes; first += W) block(q, steps, from, v, first, lanes, states, widths, sums);
    free(v);
}
