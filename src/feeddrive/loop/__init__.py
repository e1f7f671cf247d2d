"""The loop: one sample of an axis or machine under its control, and the engine that simulates and linearizes it."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "axis": "Axis",
        "box": "Box",
        "control": "Control",
        "frequency_response": "FRF",
        "gradient": "Gradient gradient",
        "guard": "Guard",
        "linearize": "compliance loop_gain tracking StateSpace linearize",
        "loop": "Loop Signals",
        "machine": "Machine",
        "simulate": "Batch Run simulate simulate_batch stream stream_each",
    },
)
