// SPDX-License-Identifier: BSD-3-Clause
// Reads a sensor on A0 at the sample time and prints what lies behind its dead zone.
#include <@name@.h>

static @name@_state state;
static @name@_in in;
static @name@_out out;
static unsigned long next_sample;
@?tunable@static @name@_params params;

void setup() {
  Serial.begin(115200);
@?tunable@  @name@_params_default(&params);
  @name@_init(&state);
  next_sample = micros();
}

void loop() {
  if ((long)(micros() - next_sample) < 0) {
    return;
  }
  next_sample += (unsigned long)(@upper@_STEP * 1e6f + 0.5f);
  in.y[0] = analogRead(A0);  // scale it to the unit in the header; fill all of `in`
  @name@_step(&state, @params@&in, &out);
  Serial.println(out.z[0]);
}
