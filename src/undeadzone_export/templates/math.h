/* Elementary functions of @name@, the same bits on every processor.
   Written by undeadzone @version@; do not edit.
   SPDX-License-Identifier: BSD-3-Clause */
#ifndef @upper@_MATH_H
#define @upper@_MATH_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
@?with_bits@#include <stdint.h>
@?with_bits@#include <string.h>

@functions@

#endif
