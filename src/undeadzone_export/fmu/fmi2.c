/* SPDX-License-Identifier: BSD-3-Clause */
/* The functions of FMI 2.0 for co-simulation around the exported step. */
#include "fmi2.h"
#include "fmu.h"

typedef struct
{
    fmu_model model;
    fmi2CallbackFunctions calls;
    char name[64];
} fmu_instance;

FMU_FLAGS(fmi2Boolean)

/* Report what is wrong to the importer. */
static fmi2Status told(const fmu_instance *instance, const char *wrong)
{
    if (wrong == NULL) {
        return fmi2OK;
    }
    if ((instance != NULL) && (instance->calls.logger != NULL)) {
        instance->calls.logger(instance->calls.componentEnvironment, instance->name, fmi2Error, "error", wrong);
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
        (void)told(instance, "this binary is for co-simulation, and of another model description");
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
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    return told(c, fmu_begin(&((fmu_instance *)c)->model, start));
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
    return told(c, fmu_get(&((fmu_instance *)c)->model, r, n, values));
}

fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[])
{
    return told(c, fmu_set(&((fmu_instance *)c)->model, r, n, values));
}

fmi2Status FMI(fmi2GetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean values[])
{
    return told(c, fmu_get_flags(&((fmu_instance *)c)->model, r, n, values));
}

fmi2Status FMI(fmi2SetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean values[])
{
    return told(c, fmu_set_flags(&((fmu_instance *)c)->model, r, n, values));
}

fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_return)
{
    (void)no_return;
    return told(c, fmu_run(&((fmu_instance *)c)->model, now, step));
}

fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    return told(c, fmu_copy(&((fmu_instance *)c)->model, state));
}

fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    return told(c, fmu_restore(&((fmu_instance *)c)->model, state));
}

fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    fmu_forget(state);
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
    return told(c, fmu_serialized(state, bytes, size));
}

fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return told(c, fmu_deserialized(bytes, size, state));
}

/* What the model has not: an error if asked for anything. */

#define ABSENT(type) \
    fmi2Status FMI(fmi2Get##type)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2##type values[]) \
    { \
        (void)r; \
        (void)values; \
        return told(c, fmu_none(n)); \
    } \
    fmi2Status FMI(fmi2Set##type)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2##type values[]) \
    { \
        (void)r; \
        (void)values; \
        return told(c, fmu_none(n)); \
    }

ABSENT(Integer)
ABSENT(String)

fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[], size_t n, const fmi2ValueReference knowns[], size_t k, const fmi2Real seed[], fmi2Real values[])
{
    (void)unknowns;
    (void)n;
    (void)knowns;
    (void)k;
    (void)seed;
    (void)values;
    return told(c, "there are no derivatives");
}

fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], const fmi2Real values[])
{
    (void)r;
    (void)n;
    (void)order;
    (void)values;
    return told(c, "there are no derivatives");
}

fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], fmi2Real values[])
{
    (void)r;
    (void)n;
    (void)order;
    (void)values;
    return told(c, "there are no derivatives");
}

fmi2Status FMI(fmi2CancelStep)(fmi2Component c)
{
    return told(c, "no step is pending");
}

#define UNKNOWN(name, type) \
    fmi2Status FMI(name)(fmi2Component c, const fmi2StatusKind kind, type *value) \
    { \
        (void)c; \
        (void)kind; \
        (void)value; \
        return fmi2Discard; \
    }

UNKNOWN(fmi2GetStatus, fmi2Status)
UNKNOWN(fmi2GetIntegerStatus, fmi2Integer)
UNKNOWN(fmi2GetStringStatus, fmi2String)

fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = ((fmu_instance *)c)->model.now;
    return fmi2OK;
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
