"""Self-calibration without motion capture: motor angles, and a few positions that are known."""
