"""The designing agent: proposes designs, learns from their steps; knows physics through those steps alone."""
