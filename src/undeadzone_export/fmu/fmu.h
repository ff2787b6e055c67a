/* SPDX-License-Identifier: BSD-3-Clause */
/* What the FMUs of both versions share: one instance, its variables by reference, and its time. */
#ifndef FMU_H
#define FMU_H

#include "fmu_model.h"
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* References count inputs, outputs, parameters, then the Booleans `missing`, then the time. */
#define FMU_FIRST_OUT FMU_INPUTS
#define FMU_FIRST_PARAM (FMU_FIRST_OUT + FMU_OUTPUTS)
#define FMU_FIRST_MISSING (FMU_FIRST_PARAM + FMU_PARAMS)
#define FMU_TIME (FMU_FIRST_MISSING + FMU_READINGS)

/* A sample that is due within this share of a sample time after the end of a step belongs to the
   next step: importers add up their steps, and so round. */
#define FMU_TOLERANCE 1e-3
#define FMU_ROUNDING 1e-9 /* share of the time by which they may be wrong then */

/* Everything that changes; its bytes are the FMU state. */
typedef struct
{
    char token[sizeof(FMU_TOKEN)];
    fmu_state state;
    fmu_params params;
    fmu_in in;
    fmu_out out;
    bool missing[FMU_READINGS];
    double start;     /* time of the first sample [s] */
    double now;       /* end of the last step [s] */
    uint64_t samples; /* taken so far */
} fmu_model;

/* The structs hold numbers of one kind, without gaps; otherwise this does not compile. */
typedef char fmu_in_has_no_gaps[(sizeof(fmu_in) == (FMU_INPUTS * sizeof(fmu_real))) ? 1 : -1];
typedef char fmu_out_has_no_gaps[(sizeof(fmu_out) == (FMU_OUTPUTS * sizeof(fmu_real))) ? 1 : -1];

/* What is known before the first sample: the outputs of a sample without readings. */
static void fmu_before(fmu_model *model)
{
    fmu_state state = model->state;
    fmu_in in = model->in;
    for (unsigned k = 0u; k < FMU_READINGS; k++) {
        in.y[k] = (fmu_real)NAN;
    }
    FMU_SAMPLE(&state, &model->params, &in, &model->out);
}

/* As instantiated. */
static void fmu_reset(fmu_model *model)
{
    (void)memset(model, 0, sizeof *model);
    (void)memcpy(model->token, FMU_TOKEN, sizeof(FMU_TOKEN));
    FMU_DEFAULT(&model->params);
    FMU_START(&model->state);
    fmu_before(model);
}

/* What follows gives what is wrong, for the importer to read; NULL: nothing is. */

static const char *const fmu_no_variable = "there is no such variable, or it cannot be set to this";

/* The time of the first sample. */
static const char *fmu_begin(fmu_model *model, double start)
{
    if (!(fabs(start) < 1e300)) {
        return "the start time is not finite";
    }
    model->start = start;
    model->now = start;
    return NULL;
}

/* The samples in [now, end) by the inputs as they are. */
static const char *fmu_run(fmu_model *model, double now, double step)
{
    const double end = now + step;
    const double due = (end - model->start) - (FMU_TOLERANCE * FMU_STEP);
    if (!(step >= 0.0) || !(fabs(end) < 1e300)) {
        return "a step must be 0 or longer, and finite";
    }
    if (!(fabs(now - model->now) <= ((FMU_TOLERANCE * FMU_STEP) + (FMU_ROUNDING * fabs(now))))) {
        return "a step must begin where the last one ended; to go back, set a state";
    }
    while (((double)model->samples * FMU_STEP) < due) {
        fmu_in in = model->in;
        for (unsigned k = 0u; k < FMU_READINGS; k++) {
            in.y[k] = model->missing[k] ? (fmu_real)NAN : in.y[k];
        }
        FMU_SAMPLE(&model->state, &model->params, &in, &model->out);
        model->samples++;
    }
    model->now = end;
    return NULL;
}

/* --- Variables */

/* Where a number is kept; NULL: there is none of this reference. */
static fmu_real *fmu_number(fmu_model *model, uint32_t reference)
{
    void *first = NULL;
    uint32_t place = reference;
    if (reference < FMU_FIRST_OUT) {
        first = &model->in;
    } else if (reference < FMU_FIRST_PARAM) {
        first = &model->out;
        place -= FMU_FIRST_OUT;
    } else if (reference < FMU_FIRST_MISSING) {
        first = &model->params;
        place -= FMU_FIRST_PARAM;
    } else {
        return NULL;
    }
    return (fmu_real *)first + place;
}

/* Read numbers. */
static const char *fmu_get(fmu_model *model, const uint32_t references[], size_t n, double values[])
{
    for (size_t k = 0u; k < n; k++) {
        const fmu_real *number = fmu_number(model, references[k]);
        if ((number == NULL) && (references[k] != FMU_TIME)) {
            return fmu_no_variable;
        }
        values[k] = (number != NULL) ? (double)*number : model->now;
    }
    return NULL;
}

/* Change inputs and parameters, which must be finite. */
static const char *fmu_set(fmu_model *model, const uint32_t references[], size_t n, const double values[])
{
    for (size_t k = 0u; k < n; k++) {
        fmu_real *number = fmu_number(model, references[k]);
        const bool is_param = references[k] >= FMU_FIRST_PARAM;
        const bool is_out = (references[k] >= FMU_FIRST_OUT) && !is_param;
        const fmu_real rounded = (fmu_real)values[k];
        if ((number == NULL) || is_out || (is_param && !isfinite(rounded))) {
            return fmu_no_variable;
        }
        *number = rounded;
    }
    return NULL;
}

/* Where a `missing` is kept; NULL: there is none of this reference. */
static bool *fmu_flag(fmu_model *model, uint32_t reference)
{
    const bool known = (reference >= FMU_FIRST_MISSING) && (reference < FMU_TIME);
    return known ? &model->missing[reference - FMU_FIRST_MISSING] : NULL;
}

/* Read and change each `missing`, as the version's own kind of Boolean. */
#define FMU_FLAGS(fmu_boolean) \
    static const char *fmu_get_flags(fmu_model *model, const uint32_t references[], size_t n, fmu_boolean values[]) \
    { \
        for (size_t k = 0u; k < n; k++) { \
            const bool *flag = fmu_flag(model, references[k]); \
            if (flag == NULL) { \
                return fmu_no_variable; \
            } \
            values[k] = *flag ? 1 : 0; \
        } \
        return NULL; \
    } \
    static const char *fmu_set_flags(fmu_model *model, const uint32_t references[], size_t n, const fmu_boolean values[]) \
    { \
        for (size_t k = 0u; k < n; k++) { \
            bool *flag = fmu_flag(model, references[k]); \
            if (flag == NULL) { \
                return fmu_no_variable; \
            } \
            *flag = values[k] != 0; \
        } \
        return NULL; \
    }

/* Variables of a kind that the model has not. */
static const char *fmu_none(size_t n)
{
    return (n == 0u) ? NULL : fmu_no_variable;
}

/* --- States */

/* Copy a state into memory that is there or is made. */
static const char *fmu_copy(const void *from, void **to)
{
    *to = (*to != NULL) ? *to : calloc(1u, sizeof(fmu_model));
    if (*to == NULL) {
        return "out of memory";
    }
    (void)memcpy(*to, from, sizeof(fmu_model));
    return NULL;
}

/* Go back to a state. */
static const char *fmu_restore(fmu_model *model, const void *state)
{
    if (state == NULL) {
        return "there is no state";
    }
    (void)memcpy(model, state, sizeof(fmu_model));
    return NULL;
}

/* Free a state. */
static void fmu_forget(void **state)
{
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
}

/* A state as bytes. */
static const char *fmu_serialized(const void *state, void *bytes, size_t size)
{
    if ((state == NULL) || (size < sizeof(fmu_model))) {
        return "there is no state, or too little memory for it";
    }
    (void)memcpy(bytes, state, sizeof(fmu_model));
    return NULL;
}

/* Bytes as a state. */
static const char *fmu_deserialized(const void *bytes, size_t size, void **state)
{
    if ((size != sizeof(fmu_model)) || (memcmp(bytes, FMU_TOKEN, sizeof(FMU_TOKEN)) != 0)) {
        return "these bytes are no state of this model";
    }
    return fmu_copy(bytes, state);
}

#endif
