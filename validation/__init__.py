"""Measurements against the model: the model file, comparison, diagnosis."""
