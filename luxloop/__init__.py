"""The hall of luxloop: the words that all rooms use. No physics beyond photometry, no learning."""

from importlib.metadata import version

__version__ = version("luxloop")
