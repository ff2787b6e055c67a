// SPDX-License-Identifier: BSD-3-Clause
// Runs the self-test of @name@ once and prints its verdict: every bit of its reference vectors.
#include <@name@.h>

extern "C" int @name@_selftest(void);

void setup() {
  Serial.begin(115200);
  while (!Serial) {
  }
  if (@name@_selftest() == 0) {
    Serial.println("@name@_test: every bit agrees");
  } else {
    Serial.println("@name@_test: FAILED");
  }
}

void loop() {
}
