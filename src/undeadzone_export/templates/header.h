/**
 * @file @name@.h
 * @title@: @part@, @real@.
 * Written by undeadzone @version@; do not edit.
 * SPDX-License-Identifier: BSD-3-Clause
 */
#ifndef @upper@_H
#define @upper@_H

#ifdef __cplusplus
extern "C" {
#endif

#define @upper@_STEP @step@ /**< sample time [s] */
#define @upper@_VERSION "@version@" /**< of undeadzone */
#define @upper@_HASH "@hash@" /**< of the graph, its numbers and the precision */

@?claims@@claims@
@structs@
@prototypes@
/** Go on from a state that was stored with its @upper@_HASH: 1. With another hash: 0, and state stays. */
static inline int @name@_resume(@name@_state *state, const @name@_state *stored, const char *hash)
{
    const char *own = @upper@_HASH;
    const char *given = hash;
    while ((*own != '\0') && (*own == *given)) {
        own++;
        given++;
    }
    int same = 0;
    if (*own == *given) {
        *state = *stored;
        same = 1;
    }
    return same;
}

#ifdef __cplusplus
}
#endif

#endif
