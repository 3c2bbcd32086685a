"""Report pages of studies and validations, with their pictures."""
