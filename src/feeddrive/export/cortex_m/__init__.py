"""A bundle for a microcontroller with a Cortex-M4F or M7, with its proof in an emulator."""
