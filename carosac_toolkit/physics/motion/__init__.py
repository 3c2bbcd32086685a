"""The platform in motion: dynamics on hanging cables, winches and braking."""
