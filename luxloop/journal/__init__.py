"""The journal of a run: what was asked, answered and decided, on disk before anybody acts on it.

The controller writes it through `journal.Journal`, with records that `topics` makes of the words of a campaign;
everybody reads it by `reader.RunJournal`, and an auditor by `scan.Scan`. Files are MCAP, which common viewers open;
nothing else of luxloop knows that. To read, check or recover one, no process need be alive.
"""
