"""Machines and jobs that come with feeddrive, as TOML files."""
