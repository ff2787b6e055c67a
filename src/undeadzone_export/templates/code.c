/* @title@: @part@, @real@.
   Written by undeadzone @version@; do not edit.
   SPDX-License-Identifier: BSD-3-Clause */

#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__)
#error "compile without -ffast-math, -fassociative-math: it changes what this code computes"
#endif
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ == 2)
#error "this compiler computes in long double (x87); use -msse2 -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

/* Numbers are compared with == where equality is meant, such as of a divisor with 0. */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif

#include "@name@.h"
@?with_math@#include "@name@_math.h"
@?with_limits@#include <float.h>
@?with_functions@#include <math.h>
@?with_truths@#include <stdbool.h>

@functions@
