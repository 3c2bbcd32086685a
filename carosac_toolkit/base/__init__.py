"""Words every module shares: arrays, errors, numbers, units, files and tables; knows no robot."""
