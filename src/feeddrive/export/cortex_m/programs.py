"""Programs for the emulated core beside the self-test: one to count instructions, one to answer to given samples."""

from __future__ import annotations

from feeddrive.export.layout import Layout


def count_program(layout: Layout) -> str:
    """The stored samples once more, with a mark before and behind each step and nothing else between the marks."""
    P = layout.routine.name
    filled = "\n".join(f"        inputs.{v.name} = samples[k][{i}];" for i, v in enumerate(layout.routine.inputs))
    return f"""\
/* Runs the stored samples between two marks, so that the instructions of each step can be counted in the emulator. */
#include "{P}_prepared.h"
#include "{P}_vectors.h"

#define MARK __attribute__((noinline, section(".count"))) static void

MARK count_begin(void)
{{
    __asm__ volatile("@ begin");
}}

MARK count_end(void)
{{
    __asm__ volatile("@ end");
}}

{P}_controller counted;

int main(void)
{{
    {P}_inputs inputs;
    {P}_outputs outputs;
    (void)expected;
    (void)changes;
    {P}_prepared(&counted);
    for (int k = 0; k < SAMPLES; k++) {{
{filled}
        if (k == 0) {{
            {P}_reset(&counted, &inputs);
        }}
        count_begin();
        {P}_step(&counted, &inputs, &outputs);
        count_end();
    }}
    return 0;
}}
"""


def answer_program(layout: Layout) -> str:
    """Reads samples from `samples.bin` on the host and writes the outputs to `answers.bin`.

    A sample is a 32-bit number, 1 if all parameters as doubles follow and 0 if not, and then the inputs.
    """
    P = layout.routine.name
    return f"""\
/* Reads samples from the host through semihosting, steps, and writes the answers: a proof with as many as are given. */
#include "{P}.h"

#include <stdio.h>

int main(void)
{{
    static {P}_controller controller;
    static char incoming[65536], outgoing[65536];
    {P}_parameters parameters;
    {P}_inputs inputs;
    {P}_outputs outputs;
    uint32_t changed;
    int begun = 0;
    FILE *samples = fopen("samples.bin", "rb"), *answers = fopen("answers.bin", "wb");
    if (!samples || !answers) {{
        return 2;
    }}
    setvbuf(samples, incoming, _IOFBF, sizeof incoming);
    setvbuf(answers, outgoing, _IOFBF, sizeof outgoing);
    {P}_defaults(&parameters);
    {P}_configure(&controller, &parameters);
    while (fread(&changed, sizeof changed, 1, samples) == 1) {{
        if (changed && fread(&parameters, sizeof parameters, 1, samples) != 1) {{
            return 2;
        }}
        if (fread(&inputs, sizeof inputs, 1, samples) != 1) {{
            return 2;
        }}
        if (!begun) {{
            {P}_reset(&controller, &inputs);
            begun = 1;
        }}
        if (changed) {{
            {P}_retune(&controller, &parameters);
        }}
        {P}_step(&controller, &inputs, &outputs);
        if (fwrite(&outputs, sizeof outputs, 1, answers) != 1) {{
            return 2;
        }}
    }}
    return fclose(answers) == 0 ? 0 : 2;
}}
"""
