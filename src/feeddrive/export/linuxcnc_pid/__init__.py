"""The target `linuxcnc-pid`: a P-PI design by the pids that a LinuxCNC has already."""
