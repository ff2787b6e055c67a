/* ear.h: the names that deadzone_update.h had before version 0.1. They go in version 0.2. */
#ifndef EAR_H
#define EAR_H
#ifdef EAR_REAL
#define DEADZONE_REAL EAR_REAL
#endif
#include "deadzone_update.h"
#define EAR_REFUSED DEADZONE_INVALID
#define ear_real deadzone_real
#define ear_hear deadzone_update
#define ear_hear_shape deadzone_update_shape
typedef DeadzoneMemory Ear;
typedef DeadzoneSensor EarSensor;
typedef DeadzoneShape EarShape;
#endif
