/* The replay on a bare Cortex-M7 (board MPS2 AN500): start of the processor, and the record by semihosting. */
#include <string.h>

#include "replay.h"

/* From mps2.ld. */
extern uint8_t stack_end[], data_begin[], data_end[], data_image[], bss_begin[], bss_end[];

#define CPACR (*(volatile uint32_t *)0xE000ED88u) /* who may use the FPU */

enum { SYS_OPEN = 0x01, SYS_WRITE0 = 0x04, SYS_READ = 0x06, SYS_EXIT = 0x18 };
#define EXIT_GOOD 0x20026u /* the application ended */
#define EXIT_BAD 0x20023u /* a fault at run time */

static uint32_t semihost(uint32_t operation, uint32_t argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register uint32_t r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uint32_t record;

uint32_t replay_read(uint8_t *to, uint32_t n)
{
    const uint32_t block[] = {record, (uint32_t)to, n};
    return n - semihost(SYS_READ, (uint32_t)block); /* it answers what was not read */
}

void replay_print(const char *text) { (void)semihost(SYS_WRITE0, (uint32_t)text); }

static void fault(void)
{
    replay_print("fault\n");
    (void)semihost(SYS_EXIT, EXIT_BAD);
}

void reset(void); /* named by mps2.ld */
void reset(void)
{
    static const char name[] = "record.bin";
    const uint32_t block[] = {(uint32_t)name, 1u /* "rb" */, sizeof name - 1u};
    CPACR |= 0xFu << 20;
    __asm__ volatile("dsb\n isb");
    memcpy(data_begin, data_image, (size_t)(data_end - data_begin));
    memset(bss_begin, 0, (size_t)(bss_end - bss_begin));
    record = semihost(SYS_OPEN, (uint32_t)block);
    (void)semihost(SYS_EXIT, replay() == 0 ? EXIT_GOOD : EXIT_BAD);
}

/* What the processor begins with: stack, reset, and the faults. */
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {
    stack_end,           (const void *)reset, (const void *)fault, (const void *)fault,
    (const void *)fault, (const void *)fault, (const void *)fault,
};
