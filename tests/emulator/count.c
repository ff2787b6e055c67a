/* Instructions of a step, and the stack that it takes: SysTick counts one tick for 40 instructions under `-icount shift=0`. */
#include "o.h"
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { SAMPLES = 64, REPEATS = 20, WORDS = 3000 };

#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define VALUE (*(volatile uint32_t *)0xE000E018u)

static o_state state;
static o_in in;
static o_out out;

static __attribute__((noinline)) void paint(void)
{
    volatile uint32_t words[WORDS];
    for (int k = 0; k < WORDS; k++) {
        words[k] = 0xA5A5A5A5u;
    }
}

static __attribute__((noinline)) unsigned painted(void)
{
    volatile uint32_t words[WORDS];
    int k = 0;
    while ((k < WORDS) && (words[k] == 0xA5A5A5A5u)) {
        k++;
    }
    return (unsigned)(4 * (WORDS - k));
}

int main(void)
{
    RELOAD = 0xFFFFFFu;
    VALUE = 0u;
    CONTROL = 5u;
    o_init(&state);
    (void)memset(&in, 0, sizeof in);
    paint();
    unsigned long most = 0ul;
    unsigned long sum = 0ul;
    for (int sample = 0; sample < SAMPLES; sample++) {
        in.y[0] = (float)((sample % 16) - 8) * 0.3f;
        const uint32_t before = VALUE;
        for (int k = 0; k < REPEATS; k++) {
            o_step(&state, &in, &out);
        }
        const unsigned long ticks = (before - VALUE) & 0xFFFFFFu;
        most = (ticks > most) ? ticks : most;
        sum += ticks;
    }
    const unsigned stack = painted();
    (void)printf("mean %lu most %lu stack %u\n", (sum * 40ul) / (SAMPLES * REPEATS), (most * 40ul) / REPEATS, stack);
    return 0;
}
