"""The nemesis: seeded faults against a real set of processes, a history of what everybody saw, and its checker."""
