/* The self-test of an export on an emulated Arduino Uno: one line on its serial port. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

int o_selftest(void);

static void put(const char *text)
{
    for (; *text != 0; text++) {
        while (!(UCSR0A & (1 << UDRE0))) {
        }
        UCSR0A |= 1 << TXC0;
        UDR0 = *text;
    }
    while (!(UCSR0A & (1 << TXC0))) {
    }
}

int main(void)
{
    UCSR0B = 1 << TXEN0;
    put(o_selftest() == 0 ? "every bit agrees\n" : "FAILED\n");
    cli();
    sleep_enable();
    sleep_cpu(); /* asleep without interrupts: the emulator ends */
    return 0;
}
