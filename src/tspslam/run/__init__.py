"""A source of pairs to a run folder."""
