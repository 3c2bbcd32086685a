"""Identification of the dynamics: the simulator, open loop, fitted to measured poses."""
