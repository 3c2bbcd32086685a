"""An emulated PLC: real ADS over TCP, winch drives with limits and faults, a simulated robot."""
