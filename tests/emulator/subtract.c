/* Does this compiler's software double round a - b correctly? See docs/export.md. */
#include <stdio.h>

int main(void)
{
    volatile double a = 1.0, b = 0x1.0000000000001p-33;
    puts(a - b == 1.0 - 0x1p-33 ? "right" : "off in the last bit");
    return 0;
}
