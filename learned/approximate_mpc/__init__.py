"""MPC as a network that has learned from it."""
