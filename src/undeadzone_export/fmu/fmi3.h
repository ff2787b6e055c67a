/* SPDX-License-Identifier: BSD-3-Clause */
/* What this FMU exports of FMI 3.0 for co-simulation: types and functions, as the standard of the
   Modelica Association (fmi-standard.org) defines them. */
#ifndef FMI3_H
#define FMI3_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(FMI3_FUNCTION_PREFIX) /* linked statically with other FMUs */
#define FMI3_JOIN_AGAIN(prefix, name) prefix##name
#define FMI3_JOIN(prefix, name) FMI3_JOIN_AGAIN(prefix, name)
#define FMI(name) FMI3_JOIN(FMI3_FUNCTION_PREFIX, name)
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

typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum {
    fmi3IntervalNotYetKnown,
    fmi3IntervalUnchanged,
    fmi3IntervalChanged
} fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);

FMI_EXPORT const char *FMI(fmi3GetVersion)(void);
FMI_EXPORT fmi3Status FMI(fmi3SetDebugLogging)(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String categories[]);
FMI_EXPORT fmi3Instance FMI(fmi3InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update);
FMI_EXPORT void FMI(fmi3FreeInstance)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3EnterInitializationMode)(fmi3Instance i, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean has_stop, fmi3Float64 stop);
FMI_EXPORT fmi3Status FMI(fmi3ExitInitializationMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3Terminate)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3Reset)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3GetFloat64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetFloat64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Boolean values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetBoolean)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Boolean values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3DoStep)(fmi3Instance i, fmi3Float64 now, fmi3Float64 step, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last);
FMI_EXPORT fmi3Status FMI(fmi3GetFMUState)(fmi3Instance i, fmi3FMUState *state);
FMI_EXPORT fmi3Status FMI(fmi3SetFMUState)(fmi3Instance i, fmi3FMUState state);
FMI_EXPORT fmi3Status FMI(fmi3FreeFMUState)(fmi3Instance i, fmi3FMUState *state);
FMI_EXPORT fmi3Status FMI(fmi3SerializedFMUStateSize)(fmi3Instance i, fmi3FMUState state, size_t *size);
FMI_EXPORT fmi3Status FMI(fmi3SerializeFMUState)(fmi3Instance i, fmi3FMUState state, fmi3Byte bytes[], size_t size);
FMI_EXPORT fmi3Status FMI(fmi3DeserializeFMUState)(fmi3Instance i, const fmi3Byte bytes[], size_t size, fmi3FMUState *state);
FMI_EXPORT fmi3Instance FMI(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log);
FMI_EXPORT fmi3Instance FMI(fmi3InstantiateScheduledExecution)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock);
FMI_EXPORT fmi3Status FMI(fmi3GetFloat32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetFloat32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int8 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int8 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetUInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt8 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetUInt8)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt8 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int16 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int16 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetUInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt16 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetUInt16)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt16 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetUInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetUInt32)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt32 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetUInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetUInt64)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetString)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3String values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetString)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3String values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3SetBinary)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Clock values[]);
FMI_EXPORT fmi3Status FMI(fmi3SetClock)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Clock values[]);
FMI_EXPORT fmi3Status FMI(fmi3GetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]);
FMI_EXPORT fmi3Status FMI(fmi3GetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]);
FMI_EXPORT fmi3Status FMI(fmi3GetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 shifts[]);
FMI_EXPORT fmi3Status FMI(fmi3GetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[]);
FMI_EXPORT fmi3Status FMI(fmi3SetIntervalDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 intervals[]);
FMI_EXPORT fmi3Status FMI(fmi3SetIntervalFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]);
FMI_EXPORT fmi3Status FMI(fmi3SetShiftDecimal)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 shifts[]);
FMI_EXPORT fmi3Status FMI(fmi3SetShiftFraction)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]);
FMI_EXPORT fmi3Status FMI(fmi3GetOutputDerivatives)(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetDirectionalDerivative)(fmi3Instance i, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t k, const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetAdjointDerivative)(fmi3Instance i, const fmi3ValueReference unknowns[], size_t n, const fmi3ValueReference knowns[], size_t k, const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetNumberOfVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t *count);
FMI_EXPORT fmi3Status FMI(fmi3GetVariableDependencies)(fmi3Instance i, fmi3ValueReference r, size_t elements[], fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3EnterConfigurationMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3ExitConfigurationMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3EnterEventMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3EnterStepMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3EvaluateDiscreteStates)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3UpdateDiscreteStates)(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next);
FMI_EXPORT fmi3Status FMI(fmi3EnterContinuousTimeMode)(fmi3Instance i);
FMI_EXPORT fmi3Status FMI(fmi3CompletedIntegratorStep)(fmi3Instance i, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *terminate);
FMI_EXPORT fmi3Status FMI(fmi3SetTime)(fmi3Instance i, fmi3Float64 time);
FMI_EXPORT fmi3Status FMI(fmi3SetContinuousStates)(fmi3Instance i, const fmi3Float64 x[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetContinuousStateDerivatives)(fmi3Instance i, fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetEventIndicators)(fmi3Instance i, fmi3Float64 values[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetContinuousStates)(fmi3Instance i, fmi3Float64 x[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetNominalsOfContinuousStates)(fmi3Instance i, fmi3Float64 nominals[], size_t count);
FMI_EXPORT fmi3Status FMI(fmi3GetNumberOfEventIndicators)(fmi3Instance i, size_t *count);
FMI_EXPORT fmi3Status FMI(fmi3GetNumberOfContinuousStates)(fmi3Instance i, size_t *count);
FMI_EXPORT fmi3Status FMI(fmi3ActivateModelPartition)(fmi3Instance i, fmi3ValueReference clock, fmi3Float64 time);

#endif
