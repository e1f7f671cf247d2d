"""The target `linuxcnc-pid`: a P-PI design realized with the stock pid components of LinuxCNC."""
