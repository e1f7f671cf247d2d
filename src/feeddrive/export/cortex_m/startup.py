"""What the self-test needs to run on a bare core: reset, memory map, and the floating-point unit switched on."""

from __future__ import annotations

STARTUP = r"""\
/* Reset of a bare core, for the self-test in the emulator only: your project has its own. */
#include <stdint.h>
#include <stdlib.h>

extern uint32_t stack_top, data_begin, data_end, data_stored, bss_begin, bss_end;
extern void initialise_monitor_handles(void);
int main(void);
void begin(void);
void reset(void);
static void stop(void);

#define FPDSCR (*(volatile uint32_t *)0xE000EF3Cu) /* what FPSCR is at the entry of an interrupt */
#define FLUSH_AND_DEFAULT_NAN (3u << 24)           /* bits 24 and 25 of FPSCR and of FPDSCR */

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)stop, (const void *)stop,
    (const void *)stop, (const void *)stop, (const void *)stop,
};

/* The floating-point unit is switched on before any compiled function can push one of its registers. */
__attribute__((naked, noreturn)) void reset(void)
{
    __asm__ volatile(
        "ldr r0, =0xE000ED88\n" /* CPACR: coprocessors 10 and 11 */
        "ldr r1, [r0]\n"
        "orr r1, r1, #0xF00000\n"
        "str r1, [r0]\n"
        "dsb\n"
        "isb\n"
        "b begin\n");
}

void begin(void)
{
    for (uint32_t *to = &data_begin, *from = &data_stored; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end;) {
        *to++ = 0u;
    }
    FPDSCR |= FLUSH_AND_DEFAULT_NAN;
    __asm__ volatile("vmsr fpscr, %0" : : "r"(FLUSH_AND_DEFAULT_NAN));
    initialise_monitor_handles();
    exit(main());
}

/* A fault ends the program with another status than 0. */
static void stop(void)
{
    exit(3);
}
"""


def linker_script(P: str) -> str:
    """The memory of the emulated boards. `core` holds the step and all that it calls, so that it can be counted."""
    return f"""\
/* The boards mps2-an386 and mps2-an500 of qemu, for the self-test only. */
ENTRY(reset)
MEMORY
{{
    CODE (rx)  : ORIGIN = 0x00000000, LENGTH = 4M
    RAM  (rwx) : ORIGIN = 0x20000000, LENGTH = 4M
}}
SECTIONS
{{
    .vectors : {{ KEEP(*(.vectors)) }} > CODE
    .core : {{
        core_begin = .;
        *(.count)
        *{P}.o(.text .text.*)
        *libm*.a:*(.text .text.*)
        *libgcc.a:*(.text .text.*)
        core_end = .;
    }} > CODE
    .text : {{ *(.text .text.*) *(.rodata .rodata.*) }} > CODE
    .ARM.exidx : {{ *(.ARM.exidx*) }} > CODE
    . = ALIGN(8);
    data_stored = LOADADDR(.data);
    .data : {{ . = ALIGN(8); data_begin = .; *(.data .data.*) . = ALIGN(8); data_end = .; }} > RAM AT > CODE
    .bss (NOLOAD) : {{ bss_begin = .; *(.bss .bss.* COMMON) . = ALIGN(8); bss_end = .; }} > RAM
    end = .;
    stack_top = ORIGIN(RAM) + LENGTH(RAM);
}}
"""
