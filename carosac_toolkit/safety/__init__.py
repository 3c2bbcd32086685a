"""Limits of commands and the stop that always remains possible."""
