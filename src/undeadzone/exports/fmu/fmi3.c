/* The functions of FMI 3.0 for co-simulation around the exported step. */
#include "fmi3.h"
#include "fmu.h"

typedef struct
{
    fmu_model model;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} fmu_instance;

static const char *const no_variable = "there is no such variable, or it cannot be set to this";

/* Report a failure to the importer. */
static fmi3Status failed(const fmu_instance *instance, const char *message)
{
    if ((instance != NULL) && (instance->log != NULL)) {
        instance->log(instance->environment, fmi3Error, "error", message);
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
        (void)failed(instance, "this binary is of another model description");
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
    fmu_instance *instance = i;
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    if (!(fabs(start) < 1e300)) {
        return failed(instance, "the start time is not finite");
    }
    instance->model.start = start;
    instance->model.now = start;
    return fmi3OK;
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
    fmu_instance *instance = i;
    if (n != count) {
        return failed(instance, "every variable holds one number");
    }
    for (size_t k = 0u; k < n; k++) {
        if (!fmu_get(&instance->model, r[k], &values[k])) {
            return failed(instance, no_variable);
        }
    }
    return fmi3OK;
}

fmi3Status FMI(fmi3SetFloat64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 values[], size_t count)
{
    fmu_instance *instance = i;
    if (n != count) {
        return failed(instance, "every variable holds one number");
    }
    for (size_t k = 0u; k < n; k++) {
        if (!fmu_set(&instance->model, r[k], values[k])) {
            return failed(instance, no_variable);
        }
    }
    return fmi3OK;
}

fmi3Status FMI(fmi3GetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Boolean values[], size_t count)
{
    fmu_instance *instance = i;
    if (n != count) {
        return failed(instance, "every variable holds one number");
    }
    for (size_t k = 0u; k < n; k++) {
        const bool *flag = fmu_flag(&instance->model, r[k]);
        if (flag == NULL) {
            return failed(instance, no_variable);
        }
        values[k] = *flag;
    }
    return fmi3OK;
}

fmi3Status FMI(fmi3SetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Boolean values[], size_t count)
{
    fmu_instance *instance = i;
    if (n != count) {
        return failed(instance, "every variable holds one number");
    }
    for (size_t k = 0u; k < n; k++) {
        bool *flag = fmu_flag(&instance->model, r[k]);
        if (flag == NULL) {
            return failed(instance, no_variable);
        }
        *flag = values[k];
    }
    return fmi3OK;
}

fmi3Status FMI(fmi3DoStep)(fmi3Instance i, fmi3Float64 now, fmi3Float64 step, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    fmu_instance *instance = i;
    (void)no_return;
    *event = false;
    *terminate = false;
    *early = false;
    const bool done = fmu_run(&instance->model, now, step);
    *last = instance->model.now;
    return done ? fmi3OK : failed(instance, "a step must be 0 or longer, and finite");
}

fmi3Status FMI(fmi3GetFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    const fmu_instance *instance = i;
    void *copy = fmu_copied(&instance->model, *state);
    if (copy == NULL) {
        return failed(instance, "out of memory");
    }
    *state = copy;
    return fmi3OK;
}

fmi3Status FMI(fmi3SetFMUState)(fmi3Instance i, fmi3FMUState state)
{
    fmu_instance *instance = i;
    if (state == NULL) {
        return failed(instance, "there is no state");
    }
    (void)fmu_copied(state, &instance->model);
    return fmi3OK;
}

fmi3Status FMI(fmi3FreeFMUState)(fmi3Instance i, fmi3FMUState *state)
{
    (void)i;
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
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
    if ((state == NULL) || (size < sizeof(fmu_model))) {
        return failed(i, "there is no state, or too little memory for it");
    }
    (void)fmu_copied(state, bytes);
    return fmi3OK;
}

fmi3Status FMI(fmi3DeserializeFMUState)(fmi3Instance i, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (!fmu_is_state(bytes, size)) {
        return failed(i, "these bytes are no state of this model");
    }
    void *copy = fmu_copied(bytes, *state);
    if (copy == NULL) {
        return failed(i, "out of memory");
    }
    *state = copy;
    return fmi3OK;
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

fmi3Status FMI(fmi3GetFloat32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetFloat32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int8 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int8 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetUInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt8 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetUInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt8 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int16 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int16 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetUInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt16 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetUInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt16 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetUInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetUInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt32 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int64 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int64 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetUInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetUInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetString)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3String values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetString)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3String values[], size_t count)
{
    (void)r;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary values[], size_t count)
{
    (void)r;
    (void)sizes;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary values[], size_t count)
{
    (void)r;
    (void)sizes;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Clock values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Clock values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)r;
    (void)intervals;
    (void)qualifiers;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 shifts[])
{
    (void)r;
    (void)shifts;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 intervals[])
{
    (void)r;
    (void)intervals;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 shifts[])
{
    (void)r;
    (void)shifts;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3SetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)r;
    (void)counters;
    (void)resolutions;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
}

fmi3Status FMI(fmi3GetOutputDerivatives)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[], size_t count)
{
    (void)r;
    (void)orders;
    (void)values;
    (void)count;
    return (n == 0u) ? fmi3OK : failed(i, no_variable);
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
    return failed(i, "there are no derivatives and no dependencies");
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
    return failed(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3GetNumberOfVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t *count)
{
    (void)r;
    (void)count;
    return failed(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3GetVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t elements[], fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[], size_t count)
{
    (void)r;
    (void)elements;
    (void)independents;
    (void)others;
    (void)kinds;
    (void)count;
    return failed(i, "there are no derivatives and no dependencies");
}

fmi3Status FMI(fmi3EnterConfigurationMode)(fmi3Instance i)
{
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3ExitConfigurationMode)(fmi3Instance i)
{
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3EnterEventMode)(fmi3Instance i)
{
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3EnterStepMode)(fmi3Instance i)
{
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3EvaluateDiscreteStates)(fmi3Instance i)
{
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3UpdateDiscreteStates)(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
{
    (void)again;
    (void)terminate;
    (void)nominals;
    (void)values;
    (void)defined;
    (void)next;
    return failed(i, "there is no such mode");
}

fmi3Status FMI(fmi3EnterContinuousTimeMode)(fmi3Instance i)
{
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3CompletedIntegratorStep)(fmi3Instance i, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate)
{
    (void)no_return;
    (void)event;
    (void)terminate;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3SetTime)(fmi3Instance i, fmi3Float64 time)
{
    (void)time;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3SetContinuousStates)(fmi3Instance i, const fmi3Float64 x[], size_t count)
{
    (void)x;
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetContinuousStateDerivatives)(fmi3Instance i, fmi3Float64 values[], size_t count)
{
    (void)values;
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetEventIndicators)(fmi3Instance i, fmi3Float64 values[], size_t count)
{
    (void)values;
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetContinuousStates)(fmi3Instance i, fmi3Float64 x[], size_t count)
{
    (void)x;
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetNominalsOfContinuousStates)(fmi3Instance i, fmi3Float64 nominals[], size_t count)
{
    (void)nominals;
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetNumberOfEventIndicators)(fmi3Instance i, size_t *count)
{
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3GetNumberOfContinuousStates)(fmi3Instance i, size_t *count)
{
    (void)count;
    return failed(i, "this FMU is for co-simulation");
}

fmi3Status FMI(fmi3ActivateModelPartition)(fmi3Instance i, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock;
    (void)time;
    return failed(i, "this FMU is for co-simulation");
}
