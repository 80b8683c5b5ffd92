"""Commands that a diagnosis prints: given as they stand there, they do what is said of them."""

from __future__ import annotations

from validation import told_diagnosis


def test_the_command_that_adds_an_effect_is_that_of_the_verdict() -> None:
    """The same model, film, parameters and solver; not what is of the diagnosis alone, or where it was written to."""
    for asked, adds in {
        "luxloop diagnose data": "luxloop add fog",
        "luxloop diagnose data --model 'my wafer.toml' --film=known --free a,b --page p.html --among fog,haze --json":
            "luxloop add fog --model 'my wafer.toml' --film=known --free a,b",
        "luxloop diagnose --twin data --seed 3 --pixel-um 20 --router tcp/127.0.0.1:1 --no-local --quiet":
            "luxloop add fog --twin --seed 3 --pixel-um 20 --router tcp/127.0.0.1:1 --no-local",
        "luxloop diagnose d --histories 4000000 --most-histories 8000000 --runs r":
            "luxloop add fog --histories 4000000 --most-histories 8000000 --runs r",
    }.items():  # fmt: skip
        assert told_diagnosis.add_command({"command": asked, "set": ["fog", "haze"]}) == adds
