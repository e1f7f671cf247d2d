"""A virtual drive whose axis falls while it is switched off, and a command beside it."""

from __future__ import annotations

import sys

FEEDDRIVE = f"{sys.executable} -c 'from feeddrive.cli import main; main()'"
# 100 kg that nothing but 1 N moves: 0.01 m/s²
HANGING = """
name = "hanging"
source = "made for a test"
sample_time_ms = 1

[axis.x.plant]
kind = "rigid"
mass_kg = 100

[[axis.x.forces]]
kind = "gravity"
force_N = -1

[axis.x.control.law]
kind = "cascade_ppi"
Kv = 100
Kp = 8000
"""
# in a folder with hanging.toml; the drive is ended as a user would end it, and says in what state it was
BESIDE = """
set -e
: > ready.txt
{feeddrive} virtual-drive hanging.toml {drive} --drive-file drive.toml > ready.txt 2>&1 &
served=$!
trap 'kill -KILL $served 2>/dev/null || true' EXIT
for attempt in $(seq 300); do grep -q Ready ready.txt && break; sleep 0.1; done
{command}
kill -INT $served
wait $served
cat ready.txt
"""
