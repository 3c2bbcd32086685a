"""Commands of learned control."""
