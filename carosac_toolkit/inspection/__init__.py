"""Consequences of a robot description: sizes, frequencies, sensitivities and doubtful numbers."""
