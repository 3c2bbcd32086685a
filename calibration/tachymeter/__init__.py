"""Exit points from a total station: levelled set-ups, blunders named, covariances kept."""
