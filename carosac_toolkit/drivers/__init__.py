"""Drivers: what can be measured and commanded, simulated, recorded or real."""
