"""The blind test: data sets that hide something, verdicts on them, and how often those were right."""
