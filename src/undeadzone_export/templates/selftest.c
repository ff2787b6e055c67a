/* Self-test of @name@: reference vectors as bits.
   Exit code 0: every bit agrees; 1: not.
   Written by undeadzone @version@; do not edit.
   SPDX-License-Identifier: BSD-3-Clause */
#include "@name@.h"
#include <inttypes.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#if defined(__AVR__) /* constants stay in flash */
#include <avr/pgmspace.h>
#define TABLE PROGMEM
#define FETCH memcpy_P
#else
#define TABLE
#define FETCH memcpy
#endif
#if defined(ARDUINO) /* a sketch calls it */
#define main @name@_selftest
int @name@_selftest(void);
#endif

enum { SAMPLES = @samples@, INPUTS = @inputs@, OUTPUTS = @outputs@, MEMORY = @memory@ };

static const @word@ given[SAMPLES][INPUTS] TABLE = {
@input_words@
};

static const @word@ expected[SAMPLES][OUTPUTS] TABLE = {
@output_words@
};

/* Checksum of the memory after each sample. */
static const uint32_t remembered[SAMPLES] TABLE = {
@state_words@
};

/* The bits of a number; every NaN has the same. */
static @word@ bits_of(const void *number)
{
    @word@ bits;
    (void)memcpy(&bits, number, sizeof bits);
    if ((bits & @magnitude@) > @infinity@) {
        bits = @nan@;
    }
    return bits;
}

static uint32_t checksum(const @name@_state *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t total = @offset@u;
    for (size_t k = 0u; k < (size_t)MEMORY; k++) {
        const @word@ bits = bits_of(bytes + (k * sizeof(@real@)));
        total = (total ^ (uint32_t)(bits & 0xffffffffu)) * @prime@u;
@?is_double@        total = (total ^ (uint32_t)(bits >> 32)) * @prime@u;
    }
    return total;
}

static int differing(const @name@_out *out, int sample)
{
    const unsigned char *bytes = (const unsigned char *)out;
    int count = 0;
    for (int k = 0; k < OUTPUTS; k++) {
        @word@ wanted;
        (void)FETCH(&wanted, &expected[sample][k], sizeof wanted);
        if (bits_of(bytes + ((size_t)k * sizeof(@real@))) != wanted) {
            count++;
        }
    }
    return count;
}

int main(void)
{
    @name@_state state;
@?phased@    @name@_state halves;
@?tunable@    @name@_params params;
    @name@_in in;
    @name@_out out;
    int outputs = 0;
    int states = 0;

@?tunable@    @name@_params_default(&params);
    @name@_init(&state);
@?phased@    @name@_init(&halves);
    if ((sizeof in != sizeof given[0]) || (sizeof out != sizeof expected[0])) {
        (void)printf("@name@_test: the structs have gaps\n");
        return 1;
    }
    for (int sample = 0; sample < SAMPLES; sample++) {
        uint32_t memory;
        (void)FETCH(&memory, &remembered[sample], sizeof memory);
        (void)FETCH(&in, given[sample], sizeof in);
        @name@_step(&state, @params@&in, &out);
        outputs += differing(&out, sample);
        states += (checksum(&state) != memory) ? 1 : 0;
@?phased@        @name@_estimate(&halves, @params@&in, &out);
@?phased@        outputs += differing(&out, sample);
@?phased@        @name@_advance(&halves, @params@&in);
@?phased@        states += (checksum(&halves) != memory) ? 1 : 0;
    }
    if ((outputs != 0) || (states != 0)) {
        (void)printf("@name@_test: FAILED: %d outputs and %d states differ\n", outputs, states);
        (void)printf("compile with -ffp-contract=off and without -ffast-math\n");
        return 1;
    }
    (void)printf("@name@_test: @samples@ samples, every bit agrees\n");
    return 0;
}
