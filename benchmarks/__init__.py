"""Speed and acceptance measurements, run by hand; results in RESULTS.md."""
