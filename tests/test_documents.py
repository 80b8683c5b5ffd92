"""What the README and the pages of docs/ point at is there, and what they tell a user to type is understood."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from luxloop.cli import app

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
SHELL = re.compile(r"\$ |docker compose run|([A-Z_]+=\S+ )+luxloop ")
"""How a line begins that a user is told to type."""
COMMANDS = ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "docs" / "blind" / "README.md"


def without_code(text: str) -> str:
    """The text of a page less its blocks and words of code."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))


def anchors(page: Path) -> set[str]:
    """What links may name behind `#`: the headings, as a forge writes them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_draft_is_left(page: Path) -> None:
    """No heading stands twice in a page, and no word in capitals holds the place of what was to come."""
    text = without_code(page.read_text())
    headings = re.findall(r"^#+ .*$", text, flags=re.M)
    assert len(headings) == len(set(headings))
    assert re.findall(r"^[A-Z]{4,}$|\b(?:TABLE|CONCLUSION|TODO|FIXME|XXX|HASH)\b", text, flags=re.M) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """Files and headings that a page points at are there."""
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_code(page.read_text())):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def commands_in(line: str) -> list[list[str]]:
    """The words of each command of luxloop in a shell's line, from the first word after `luxloop`."""
    line = re.sub(r"\d(?=>)", "", line.removeprefix("$ "))
    lexer = shlex.shlex(line, posix=True, punctuation_chars="&;|<>")
    lexer.whitespace_split = True
    found: list[list[str]] = [[]]
    for word in lexer:
        if word and set(word) <= set("&;|<>"):
            found.append([])
        else:
            found[-1].append(word)
    return [rest for words in found if (rest := after_luxloop(words))]


def after_luxloop(words: list[str]) -> list[str]:
    """What follows the program's name; nothing where another program is called."""
    while words and re.fullmatch(r"[A-Z_][A-Z0-9_]*=.*", words[0]):
        words = words[1:]
    if words[:3] == ["docker", "compose", "run"] and "campaign" in words:  # the service, whose entry point is luxloop
        return words[words.index("campaign") + 1 :]
    return words[1:] if words[:1] == ["luxloop"] else []


def typed() -> list[str]:
    """The commands of luxloop that the pages tell a user to type, each once."""
    blocks = [
        block for page in COMMANDS for block in re.findall(r"^```\w*\n(.*?)^```", page.read_text(), flags=re.M | re.S)
    ]
    lines = [line for block in blocks for line in block.splitlines() if SHELL.match(line)]
    return sorted({shlex.join(words) for line in lines for words in commands_in(line)})


@pytest.fixture(scope="module")
def root() -> Any:
    """All commands, as click has them."""
    return typer.main.get_command(app())


def test_the_pages_tell_of_commands() -> None:
    """The search for them finds what it should."""
    assert commands_in("$ LUXLOOP_CERTS=client luxloop doctor  # dates; clocks") == [["doctor"]]
    assert commands_in("$ cp a b && luxloop film --stack 'Si | air' | head") == [["film", "--stack", "Si | air"]]
    assert commands_in("docker compose run --rm -v ./a:/b:ro campaign campaign list") == [["campaign", "list"]]
    assert len(typed()) > 80


def test_an_option_that_is_none_is_found(root: Any) -> None:
    """The check below refuses what the command would refuse."""
    with pytest.raises(Exception, match="No such option"):
        test_commands_of_the_pages_are_understood(root, "film --no-such")
    with pytest.raises(AssertionError):
        test_commands_of_the_pages_are_understood(root, "film no_such")


@pytest.mark.parametrize("line", typed())
def test_commands_of_the_pages_are_understood(root: Any, line: str) -> None:
    """Commands exist, with these options, and get what they cannot do without; values are not looked at."""
    words = shlex.split(line)
    command, context = root, root.make_context("luxloop", [], resilient_parsing=True)
    while hasattr(command, "commands"):
        assert words, "a group alone does nothing"
        assert words[0] in command.commands
        command = command.commands[words.pop(0)]
    context = command.context_class(command, parent=context)
    given, left, _ = command.make_parser(context).parse_args(words)  # raises where an option is unknown
    assert left == []
    assert [param.name for param in command.params if param.required and given.get(param.name) in (None, ())] == []
