/* SPDX-License-Identifier: BSD-3-Clause */
/* The functions of FMI 3.0 for co-simulation around the exported step. */
#include "fmi3.h"
#include "fmu.h"

typedef struct
{
    fmu_model model;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} fmu_instance;

FMU_FLAGS(fmi3Boolean)

static const char *const one_number = "every variable holds one number";

/* Report what is wrong to the importer. */
static fmi3Status told(const fmu_instance *instance, const char *wrong)
{
    if (wrong == NULL) {
        return fmi3OK;
    }
    if ((instance != NULL) && (instance->log != NULL)) {
        instance->log(instance->environment, fmi3Error, "error", wrong);
    }
    return fmi3Error;
}

const char *FMI(fmi3GetVersion)(void)
{
    return "3.0";
}

fmi3Status FMI(fmi3SetDebugLogging)(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)i;
    (void)on;
    (void)n;
    (void)categories;
    return fmi3OK;
}

fmi3Instance FMI(fmi3InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)events;
    (void)early;
    (void)required;
    (void)n;
    (void)update;
    fmu_instance *instance = calloc(1u, sizeof *instance);
    if (instance == NULL) {
        return NULL;
    }
    instance->environment = environment;
    instance->log = log;
    if ((token == NULL) || (strcmp(token, FMU_TOKEN) != 0)) {
        (void)told(instance, "this binary is of another model description");
        free(instance);
        return NULL;
    }
    fmu_reset(&instance->model);
    return instance;
}

void FMI(fmi3FreeInstance)(fmi3Instance i)
{
    free(i);
}

fmi3Status FMI(fmi3EnterInitializationMode)(fmi3Instance i, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop)
{
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    return told(i, fmu_begin(&((fmu_instance *)i)->model, start));
}

fmi3Status FMI(fmi3ExitInitializationMode)(fmi3Instance i)
{
    fmu_before(&((fmu_instance *)i)->model);
    return fmi3OK;
}

fmi3Status FMI(fmi3Terminate)(fmi3Instance i)
{
    (void)i;
    return fmi3OK;
}

fmi3Status FMI(fmi3Reset)(fmi3Instance i)
{
    fmu_reset(&((fmu_instance *)i)->model);
    return fmi3OK;
}

fmi3Status FMI(fmi3GetFloat64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 values[], size_t count)
{
    return told(i, (n == count) ? fmu_get(&((fmu_instance *)i)->model, r, n, values) : one_number);
}

fmi3Status FMI(fmi3SetFloat64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 values[], size_t count)
{
    return told(i, (n == count) ? fmu_set(&((fmu_instance *)i)->model, r, n, values) : one_number);
}

fmi3Status FMI(fmi3GetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Boolean values[], size_t count)
{
    return told(i, (n == count) ? fmu_get_flags(&((fmu_instance *)i)->model, r, n, values) : one_number);
}

fmi3Status FMI(fmi3SetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Boolean values[], size_t count)
{
    return told(i, (n == count) ? fmu_set_flags(&((fmu_instance *)i)->model, r, n, values) : one_number);
}

fmi3Status FMI(fmi3DoStep)(fmi3Instance i, fmi3Float64 now, fmi3Float64 step, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)no_return;
    *event = false;
    *terminate = false;
    *early = false;
    const char *wrong = fmu_run(&((fmu_instance *)i)->model, now, step);
    *last = ((fmu_instance *)i)->model.now;
    return told(i, wrong);
}

fmi3Status FMI(fmi3GetFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    return told(i, fmu_copy(&((fmu_instance *)i)->model, state));
}

fmi3Status FMI(fmi3SetFMUState)(fmi3Instance i, fmi3FMUState state)
{
    return told(i, fmu_restore(&((fmu_instance *)i)->model, state));
}

fmi3Status FMI(fmi3FreeFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    (void)i;
    fmu_forget(state);
    return fmi3OK;
}

fmi3Status FMI(fmi3SerializedFMUStateSize)(fmi3Instance i, fmi3FMUState state, size_t *size)
{
    (void)i;
    (void)state;
    *size = sizeof(fmu_model);
    return fmi3OK;
}

fmi3Status FMI(fmi3SerializeFMUState)(fmi3Instance i, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    return told(i, fmu_serialized(state, bytes, size));
}

fmi3Status FMI(fmi3DeserializeFMUState)(fmi3Instance i, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    return told(i, fmu_deserialized(bytes, size, state));
}

/* What the model has not: an error if asked for anything. */

fmi3Instance FMI(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)log;
    return NULL;
}

fmi3Instance FMI(fmi3InstantiateScheduledExecution)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)environment;
    (void)log;
    (void)update;
    (void)lock;
    (void)unlock;
    return NULL;
}

#define ABSENT(type) \
    fmi3Status FMI(fmi3Get##type)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3##type values[], size_t count) \
    { \
        (void)r; \
        (void)values; \
        (void)count; \
        return told(i, fmu_none(n)); \
    } \
    fmi3Status FMI(fmi3Set##type)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3##type values[], size_t count) \
    { \
        (void)r; \
        (void)values; \
        (void)count; \
        return told(i, fmu_none(n)); \
    }

ABSENT(Float32)
ABSENT(Int8)
ABSENT(UInt8)
ABSENT(Int16)
ABSENT(UInt16)
ABSENT(Int32)
ABSENT(UInt32)
ABSENT(Int64)
ABSENT(UInt64)
ABSENT(String)

fmi3Status FMI(fmi3GetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary values[], size_t count)
{
    (void)r;
    (void)sizes;
    (void)values;
    (void)count;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary values[], size_t count)
{
    (void)r;
    (void)sizes;
    (void)values;
    (void)count;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Clock values[])
{
    (void)r;
    (void)values;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Clock values[])
{
    (void)r;
    (void)values;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)r;
    (void)intervals;
    (void)qualifiers;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 shifts[])
{
    (void)r;
    (void)shifts;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 intervals[])
{
    (void)r;
    (void)intervals;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 shifts[])
{
    (void)r;
    (void)shifts;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3SetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetOutputDerivatives)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[], size_t count)
{
    (void)r;
    (void)orders;
    (void)values;
    (void)count;
    return told(i, fmu_none(n));
}

fmi3Status FMI(fmi3GetDirectionalDerivative)(fmi3Instance i, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t k, const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t count)
{
    (void)unknowns;
    (void)n;
    (void)knowns;
    (void)k;
    (void)seed;
    (void)seeds;
    (void)values;
    (void)count;
    return told(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3GetAdjointDerivative)(fmi3Instance i, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t k, const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t count)
{
    (void)unknowns;
    (void)n;
    (void)knowns;
    (void)k;
    (void)seed;
    (void)seeds;
    (void)values;
    (void)count;
    return told(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3GetNumberOfVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t *count)
{
    (void)r;
    (void)count;
    return told(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3GetVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t elements[], fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[], size_t count)
{
    (void)r;
    (void)elements;
    (void)independents;
    (void)others;
    (void)kinds;
    (void)count;
    return told(i, "there are no derivatives and no dependencies");
}

#define NO_MODE(name) \
    fmi3Status FMI(name)(fmi3Instance i) \
    { \
        return told(i, "there is no such mode"); \
    }

NO_MODE(fmi3EnterConfigurationMode)
NO_MODE(fmi3ExitConfigurationMode)
NO_MODE(fmi3EnterEventMode)
NO_MODE(fmi3EnterStepMode)
NO_MODE(fmi3EvaluateDiscreteStates)

fmi3Status FMI(fmi3UpdateDiscreteStates)(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
{
    (void)again;
    (void)terminate;
    (void)nominals;
    (void)values;
    (void)defined;
    (void)next;
    return told(i, "there is no such mode");
}

static const char *const discrete = "this FMU is for co-simulation";

#define NO_STATES(name, kind) \
    fmi3Status FMI(name)(fmi3Instance i, kind values[], size_t count) \
    { \
        (void)values; \
        (void)count; \
        return told(i, discrete); \
    }
#define NO_NUMBER(name) \
    fmi3Status FMI(name)(fmi3Instance i, size_t *count) \
    { \
        (void)count; \
        return told(i, discrete); \
    }

NO_STATES(fmi3SetContinuousStates, const fmi3Float64)
NO_STATES(fmi3GetContinuousStates, fmi3Float64)
NO_STATES(fmi3GetContinuousStateDerivatives, fmi3Float64)
NO_STATES(fmi3GetEventIndicators, fmi3Float64)
NO_STATES(fmi3GetNominalsOfContinuousStates, fmi3Float64)
NO_NUMBER(fmi3GetNumberOfEventIndicators)
NO_NUMBER(fmi3GetNumberOfContinuousStates)

fmi3Status FMI(fmi3EnterContinuousTimeMode)(fmi3Instance i)
{
    return told(i, discrete);
}

fmi3Status FMI(fmi3CompletedIntegratorStep)(fmi3Instance i, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate)
{
    (void)no_return;
    (void)event;
    (void)terminate;
    return told(i, discrete);
}

fmi3Status FMI(fmi3SetTime)(fmi3Instance i, fmi3Float64 time)
{
    (void)time;
    return told(i, discrete);
}

fmi3Status FMI(fmi3ActivateModelPartition)(fmi3Instance i, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock;
    (void)time;
    return told(i, discrete);
}
