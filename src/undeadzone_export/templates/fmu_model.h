/* What fmu.h needs to know of @name@; written by undeadzone @version@, do not edit.
   SPDX-License-Identifier: BSD-3-Clause */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#include "@name@.h"

#define FMU_TOKEN "@token@"
#define FMU_STEP @step@ /* [s] */
#define FMU_INPUTS @inputs@u
#define FMU_READINGS @readings@u
#define FMU_OUTPUTS @outputs@u
#define FMU_PARAMS @params@u

typedef @real@ fmu_real;
typedef @name@_state fmu_state;
typedef @name@_in fmu_in;
typedef @name@_out fmu_out;
@?tunable@typedef @name@_params fmu_params;
@?tunable@#define FMU_DEFAULT(params) @name@_params_default(params)
@?tunable@#define FMU_SAMPLE(state, params, in, out) @name@_step(state, params, in, out)
@?fixed@typedef struct
@?fixed@{
@?fixed@    @real@ none;
@?fixed@} fmu_params;
@?fixed@#define FMU_DEFAULT(params) ((params)->none = 0)
@?fixed@#define FMU_SAMPLE(state, params, in, out) @name@_step(state, in, out)
#define FMU_START(state) @name@_init(state)

#endif
