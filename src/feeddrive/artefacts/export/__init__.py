"""What runs elsewhere: one step function as text for C compilers, LinuxCNC, simulation tools and PLCs."""
