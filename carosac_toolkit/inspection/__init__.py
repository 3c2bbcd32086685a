"""What a robot description implies: sizes, frequencies, sensitivities and doubtful numbers."""
