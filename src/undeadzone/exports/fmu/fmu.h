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

/* The samples in [now, end) by the inputs as they are; false: no step that can be made. */
static bool fmu_run(fmu_model *model, double now, double step)
{
    const double end = now + step;
    const double due = (end - model->start) - (FMU_TOLERANCE * FMU_STEP);
    if (!(step >= 0.0) || !(fabs(end) < 1e300)) {
        return false;
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
    return true;
}

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

/* Read a number; false: there is none. */
static bool fmu_get(fmu_model *model, uint32_t reference, double *value)
{
    const fmu_real *number = fmu_number(model, reference);
    if (number != NULL) {
        *value = (double)*number;
    } else if (reference == FMU_TIME) {
        *value = model->now;
    } else {
        return false;
    }
    return true;
}

/* Change an input or a parameter, which must be finite; false: it cannot be done. */
static bool fmu_set(fmu_model *model, uint32_t reference, double value)
{
    fmu_real *number = fmu_number(model, reference);
    const bool is_param = reference >= FMU_FIRST_PARAM;
    const bool is_out = (reference >= FMU_FIRST_OUT) && !is_param;
    const fmu_real rounded = (fmu_real)value;
    if ((number == NULL) || is_out || (is_param && !isfinite(rounded))) {
        return false;
    }
    *number = rounded;
    return true;
}

/* Where a `missing` is kept; NULL: there is none of this reference. */
static bool *fmu_flag(fmu_model *model, uint32_t reference)
{
    const bool known = (reference >= FMU_FIRST_MISSING) && (reference < FMU_TIME);
    return known ? &model->missing[reference - FMU_FIRST_MISSING] : NULL;
}

/* A copy of a state into memory that is there or is made; NULL: out of memory. */
static void *fmu_copied(const void *from, void *to)
{
    void *target = (to != NULL) ? to : calloc(1u, sizeof(fmu_model));
    if (target != NULL) {
        (void)memcpy(target, from, sizeof(fmu_model));
    }
    return target;
}

/* Whether bytes are a state of this model. */
static bool fmu_is_state(const void *bytes, size_t size)
{
    return (size == sizeof(fmu_model)) && (memcmp(bytes, FMU_TOKEN, sizeof(FMU_TOKEN)) == 0);
}

#endif
