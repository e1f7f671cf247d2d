"""Files people touch: TOML in and out, measured logs, runs, result directories."""
