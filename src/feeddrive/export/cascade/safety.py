"""What stands at the head of every file that a person will type into a control: safety, and the four units of Kv."""

from __future__ import annotations

SAFETY = (
    "Text for a person to check, not a file to load blindly.  Before the first motion:",
    "1. Compare every unit with the manual of your control and drive; a gain off by 60 or 1000 is a runaway axis.",
    "2. Set torque, speed and travel limits low, and try the emergency stop while nothing moves.",
    "3. Turn the motor uncoupled from the axis first, then coupled, with free travel on both sides.",
    "4. Hold a vertical axis by more than its drive: it falls when a loop opens.",
    "5. Begin with a tenth of the gains, velocity loop before position loop; stay away from everything that can move.",
)


def kv_lines(Kv: float) -> tuple[str, ...]:
    """The position gain (1/s) in the units of the trade."""
    return (
        f"Kv = {Kv:.6g} 1/s = {Kv:.6g} (mm/s)/mm",
        f"Kv = {Kv * 0.06:.6g} (m/min)/mm = {Kv * 0.06:.6g} 1000/min; 1 (m/min)/mm is 16.667 1/s",
        f"Kv = {Kv * 100.0:.6g} times 0.01/s",
        f"Following error at 1 m/min without velocity feedforward: {1e3 / (60.0 * Kv):.4g} mm",
    )
