"""Parameters of ODrive, in turns."""

from __future__ import annotations

import math

from feeddrive.export.parameters.maker import Filtered, Maker, Row
from feeddrive.export.parameters.unsupported import Lost

_SOURCE = "odriverobotics/ODrive, Firmware/MotorControl/controller.hpp (firmware 0.5), the units beside the fields"
_NO_FILTER = "there is no filter between velocity controller and torque"
_CONFIG = "odrv0.axis0.controller.config"

ROWS = (
    Row(f"{_CONFIG}.pos_gain", "Kv", "(turn/s)/turn", "1/s", "position gain", _SOURCE),
    Row(f"{_CONFIG}.vel_gain", "Kp", "Nm/(turn/s)", "N m s/rev", "velocity gain", _SOURCE),
    Row(f"{_CONFIG}.vel_integrator_gain", "Kp/Tn", "Nm/(turn/s * s)", "N m/rev", "Kp/Tn", _SOURCE),
    Row(f"{_CONFIG}.vel_limit", "velocity_limit", "turn/s", "rev/s", "speed limit of the velocity command"),
    Row("odrv0.axis0.motor.config.torque_lim", "force_limit", "Nm", "N m",
        "torque limit; firmware 0.6: odrv0.axis0.config.torque_soft_max"),
    Row(f"{_CONFIG}.inertia", "mass", "Nm/(turn/s^2)", "kg m2",
        "inertia, used by the input modes that make an acceleration themselves", scale=2.0 * math.pi),
)  # fmt: skip


ODRIVE = Maker(
    key="odrive",
    title="ODrive, as commands of odrivetool",
    comment="#",
    rows=ROWS,
    held=("force_limit",),
    filters=lambda *_: Filtered(why=_NO_FILTER),
    rotary=True,
    outside={
        "filters": (_NO_FILTER, ""),
        "back_calculation": ("the integral leaks away while a limit acts", ""),
        "inertia": (
            "with input_mode PASSTHROUGH the torque that goes with an acceleration is the sender's: input_torque",
            "send mass · acceleration, as a torque, with every setpoint",
        ),
        "viscous_feedforward": ("it is the sender's: input_torque", "send it with every setpoint"),
        "half_sample": ("it is the sender's", "shift what is sent by half a period of the sender"),
        "friction_feedforward": ("it is the sender's: input_torque", "send it with every setpoint"),
        "velocity_limit": ("vel_limit bounds the command; vel_limit_tolerance times it trips", "check that factor"),
        "following_error_limit": ("it watches the velocity only", ""),
        "travel": ("it has no software end positions in this mode", "watch them where the setpoints are made"),
        "broken_readings": ("encoder faults disarm it", ""),
    },
    notes=(
        "turn: of the motor's shaft.  vel_integrator_gain is Kp/Tn, not 1/Tn; set it to 0 where there is no Tn.",
        "Velocity feedforward is the sender's: send share times the set velocity as input_vel.",
    ),
    always=(
        Lost(
            "control.law.velocity_feedforward", "", "the set velocity is the sender's: input_vel",
            "without it the following error is v/Kv",
        ),
        Lost(
            "sample_time", "", "its loop runs at 8 kHz, the encoder is observed with encoder.config.bandwidth",
            "that bandwidth is a delay in the velocity loop which this design does not know",
        ),
    ),
)  # fmt: skip
