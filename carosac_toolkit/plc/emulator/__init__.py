"""The emulated PLC: AMS server, PLC program, winches and a simulated robot."""
