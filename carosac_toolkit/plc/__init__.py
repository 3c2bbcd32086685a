"""A robot behind a PLC: driver, data blocks and links; `emulator` is a PLC to rehearse with."""
