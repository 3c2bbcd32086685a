"""Cases of a study, run to rows on one machine or many."""
