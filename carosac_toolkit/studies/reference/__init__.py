"""The versioned reference suite."""
