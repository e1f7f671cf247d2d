"""A small axis that is commissioned in half a minute."""

# two masses under a P-PI at 1 kHz: few samples, so that all of it takes half a minute
MACHINE = """
name = "a small axis"
source = "made up"
sample_time_ms = 1
[axis.x]
plant = { kind = "two_mass", mass_motor_kg = 60, mass_load_kg = 40, stiffness_N_per_um = 20, damping = 2000, viscous_motor = 300 }
friction_load = { kind = "coulomb", coulomb_N = 40 }
encoder_motor = { kind = "encoder", resolution_nm = 10 }
encoder_load = { kind = "encoder", resolution_nm = 10 }
[axis.x.control]
force_limit_N = 1500
guard = { following_error_limit_mm = 2, velocity_limit = 0.5 }
law = { kind = "cascade_ppi", Kv = 15, Kp = 8e3, Tn_ms = 40 }
"""  # noqa: E501  # as a person writes it
