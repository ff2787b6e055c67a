/* Vector table and start of a Cortex-M4F for the emulator: copies data, clears bss, turns the FPU on. */
#include <stdint.h>

extern uint32_t stack_end, data_image, data_start, data_end, bss_start, bss_end;
extern int main(void);
extern void __libc_init_array(void);
extern void initialise_monitor_handles(void);
extern void exit(int code);
void reset(void);

void _init(void) {}
void _fini(void) {}

static void fault(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    &stack_end, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
};

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* access to the FPU */
    __asm volatile("dsb\nisb");
    const uint32_t *from = &data_image;
    for (uint32_t *to = &data_start; to < &data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = &bss_start; to < &bss_end; to++) {
        *to = 0;
    }
    __libc_init_array();
    initialise_monitor_handles();
    exit(main());
}
