"""The auditor of runs: what a journal holds, and whether it is still what was written."""
