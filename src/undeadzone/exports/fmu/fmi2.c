/* The functions of FMI 2.0 for co-simulation around the exported step. */
#include "fmi2.h"
#include "fmu.h"

typedef struct
{
    fmu_model model;
    fmi2CallbackFunctions calls;
    char name[64];
} fmu_instance;

static const char *const no_variable = "there is no such variable, or it cannot be set to this";

/* Report a failure to the importer. */
static fmi2Status failed(const fmu_instance *instance, const char *message)
{
    if ((instance != NULL) && (instance->calls.logger != NULL)) {
        instance->calls.logger(instance->calls.componentEnvironment, instance->name, fmi2Error, "error", message);
    }
    return fmi2Error;
}

const char *FMI(fmi2GetTypesPlatform)(void)
{
    return "default";
}

const char *FMI(fmi2GetVersion)(void)
{
    return "2.0";
}

fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi2OK;
}

fmi2Component FMI(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources;
    (void)visible;
    (void)logging;
    fmu_instance *instance = calloc(1u, sizeof *instance);
    if (instance == NULL) {
        return NULL;
    }
    if (functions != NULL) {
        instance->calls = *functions;
    }
    if (name != NULL) {
        (void)strncpy(instance->name, name, sizeof instance->name - 1u);
    }
    if ((type != fmi2CoSimulation) || (guid == NULL) || (strcmp(guid, FMU_TOKEN) != 0)) {
        (void)failed(instance, "this binary is for co-simulation, and of another model description");
        free(instance);
        return NULL;
    }
    fmu_reset(&instance->model);
    return instance;
}

void FMI(fmi2FreeInstance)(fmi2Component c)
{
    free(c);
}

fmi2Status FMI(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    fmu_instance *instance = c;
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    if (!(fabs(start) < 1e300)) {
        return failed(instance, "the start time is not finite");
    }
    instance->model.start = start;
    instance->model.now = start;
    return fmi2OK;
}

fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c)
{
    fmu_before(&((fmu_instance *)c)->model);
    return fmi2OK;
}

fmi2Status FMI(fmi2Terminate)(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status FMI(fmi2Reset)(fmi2Component c)
{
    fmu_reset(&((fmu_instance *)c)->model);
    return fmi2OK;
}

fmi2Status FMI(fmi2GetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[])
{
    fmu_instance *instance = c;
    for (size_t k = 0u; k < n; k++) {
        if (!fmu_get(&instance->model, r[k], &values[k])) {
            return failed(instance, no_variable);
        }
    }
    return fmi2OK;
}

fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[])
{
    fmu_instance *instance = c;
    for (size_t k = 0u; k < n; k++) {
        if (!fmu_set(&instance->model, r[k], values[k])) {
            return failed(instance, no_variable);
        }
    }
    return fmi2OK;
}

fmi2Status FMI(fmi2GetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean values[])
{
    fmu_instance *instance = c;
    for (size_t k = 0u; k < n; k++) {
        const bool *flag = fmu_flag(&instance->model, r[k]);
        if (flag == NULL) {
            return failed(instance, no_variable);
        }
        values[k] = *flag ? 1 : 0;
    }
    return fmi2OK;
}

fmi2Status FMI(fmi2SetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean values[])
{
    fmu_instance *instance = c;
    for (size_t k = 0u; k < n; k++) {
        bool *flag = fmu_flag(&instance->model, r[k]);
        if (flag == NULL) {
            return failed(instance, no_variable);
        }
        *flag = values[k] != 0;
    }
    return fmi2OK;
}

fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_return)
{
    fmu_instance *instance = c;
    (void)no_return;
    return fmu_run(&instance->model, now, step) ? fmi2OK : failed(instance, "a step must be 0 or longer, and finite");
}

fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    const fmu_instance *instance = c;
    void *copy = fmu_copied(&instance->model, *state);
    if (copy == NULL) {
        return failed(instance, "out of memory");
    }
    *state = copy;
    return fmi2OK;
}

fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    fmu_instance *instance = c;
    if (state == NULL) {
        return failed(instance, "there is no state");
    }
    (void)fmu_copied(state, &instance->model);
    return fmi2OK;
}

fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(fmu_model);
    return fmi2OK;
}

fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if ((state == NULL) || (size < sizeof(fmu_model))) {
        return failed(c, "there is no state, or too little memory for it");
    }
    (void)fmu_copied(state, bytes);
    return fmi2OK;
}

fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (!fmu_is_state(bytes, size)) {
        return failed(c, "these bytes are no state of this model");
    }
    void *copy = fmu_copied(bytes, *state);
    if (copy == NULL) {
        return failed(c, "out of memory");
    }
    *state = copy;
    return fmi2OK;
}

/* What the model has not: an error if asked for anything. */

fmi2Status FMI(fmi2GetInteger)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi2OK : failed(c, no_variable);
}

fmi2Status FMI(fmi2GetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi2OK : failed(c, no_variable);
}

fmi2Status FMI(fmi2SetInteger)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi2OK : failed(c, no_variable);
}

fmi2Status FMI(fmi2SetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String values[])
{
    (void)r;
    (void)values;
    return (n == 0u) ? fmi2OK : failed(c, no_variable);
}

fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[], size_t n, const fmi2ValueReference knowns[], size_t k, const fmi2Real seed[], fmi2Real values[])
{
    (void)unknowns;
    (void)n;
    (void)knowns;
    (void)k;
    (void)seed;
    (void)values;
    return failed(c, "there are no derivatives");
}

fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], const fmi2Real values[])
{
    (void)r;
    (void)n;
    (void)order;
    (void)values;
    return failed(c, "there are no derivatives");
}

fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], fmi2Real values[])
{
    (void)r;
    (void)n;
    (void)order;
    (void)values;
    return failed(c, "there are no derivatives");
}

fmi2Status FMI(fmi2CancelStep)(fmi2Component c)
{
    return failed(c, "no step is pending");
}

fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = ((fmu_instance *)c)->model.now;
    return fmi2OK;
}

fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = 0;
    return fmi2OK;
}

fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c;
    (void)kind;
    (void)value;
    return fmi2Discard;
}
