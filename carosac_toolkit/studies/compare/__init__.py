"""Comparative studies: settings, results, paired statistics and tables."""
