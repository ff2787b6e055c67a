/* SPDX-License-Identifier: BSD-3-Clause */
/* What this FMU exports of FMI 2.0 for co-simulation: types and functions, as the standard of the
   Modelica Association (fmi-standard.org) defines them. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>

#if defined(FMI2_FUNCTION_PREFIX) /* linked statically with other FMUs */
#define FMI2_JOIN_AGAIN(prefix, name) prefix##name
#define FMI2_JOIN(prefix, name) FMI2_JOIN_AGAIN(prefix, name)
#define FMI(name) FMI2_JOIN(FMI2_FUNCTION_PREFIX, name)
#define FMI_EXPORT
#else
#define FMI(name) name
#if defined(_WIN32)
#define FMI_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI_EXPORT __attribute__((visibility("default")))
#else
#define FMI_EXPORT
#endif
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus,
    fmi2PendingStatus,
    fmi2LastSuccessfulTime,
    fmi2Terminated
} fmi2StatusKind;

typedef struct
{
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

FMI_EXPORT const char *FMI(fmi2GetTypesPlatform)(void);
FMI_EXPORT const char *FMI(fmi2GetVersion)(void);
FMI_EXPORT fmi2Status FMI(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]);
FMI_EXPORT fmi2Component FMI(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging);
FMI_EXPORT void FMI(fmi2FreeInstance)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop, fmi2Real stop);
FMI_EXPORT fmi2Status FMI(fmi2EnterInitializationMode)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2ExitInitializationMode)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2Terminate)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2Reset)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2GetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[]);
FMI_EXPORT fmi2Status FMI(fmi2GetInteger)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer values[]);
FMI_EXPORT fmi2Status FMI(fmi2GetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean values[]);
FMI_EXPORT fmi2Status FMI(fmi2GetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String values[]);
FMI_EXPORT fmi2Status FMI(fmi2SetReal)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[]);
FMI_EXPORT fmi2Status FMI(fmi2SetInteger)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer values[]);
FMI_EXPORT fmi2Status FMI(fmi2SetBoolean)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean values[]);
FMI_EXPORT fmi2Status FMI(fmi2SetString)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String values[]);
FMI_EXPORT fmi2Status FMI(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state);
FMI_EXPORT fmi2Status FMI(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state);
FMI_EXPORT fmi2Status FMI(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state);
FMI_EXPORT fmi2Status FMI(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size);
FMI_EXPORT fmi2Status FMI(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size);
FMI_EXPORT fmi2Status FMI(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state);
FMI_EXPORT fmi2Status FMI(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[], size_t n, const fmi2ValueReference knowns[], size_t k, const fmi2Real seed[], fmi2Real values[]);
FMI_EXPORT fmi2Status FMI(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], const fmi2Real values[]);
FMI_EXPORT fmi2Status FMI(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[], fmi2Real values[]);
FMI_EXPORT fmi2Status FMI(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_return);
FMI_EXPORT fmi2Status FMI(fmi2CancelStep)(fmi2Component c);
FMI_EXPORT fmi2Status FMI(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value);
FMI_EXPORT fmi2Status FMI(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value);
FMI_EXPORT fmi2Status FMI(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value);
FMI_EXPORT fmi2Status FMI(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value);
FMI_EXPORT fmi2Status FMI(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value);

#endif
