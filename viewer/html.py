"""The words of every page: escaped text, numbers with errors, tables, figures with captions; nothing is loaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from luxloop.files import whole

Row = Sequence[str]
NOTHING = "-"
IN_ADDRESS = str.maketrans({"%": "%25", "#": "%23", '"': "%22", "&": "%26", "\n": " "})
"""What in a picture would end or change the address that holds it; base64 would make it a third larger."""

STYLE = """
:root { color-scheme: light dark; --ink: #1d2430; --soft: #5a6474; --line: #d8dde5; --paper: #ffffff; --tint: #f4f6f9; --mark: #0b62a8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ee; --soft: #9aa5b5; --line: #39424f; --paper: #151a21; --tint: #1e252e; --mark: #6db7f2; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 2rem 1.2rem 4rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 .6rem; padding-top: .6rem; border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 48rem; }
nav { margin: 1rem 0; font-size: .92rem; } nav a { margin-right: .9rem; white-space: nowrap; }
a { color: var(--mark); text-decoration: none; } a:hover { text-decoration: underline; }
.soft, figcaption, caption { color: var(--soft); font-size: .88rem; }
.big { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.2rem 0; }
.big div { flex: 1 1 11rem; background: var(--tint); border-radius: .5rem; padding: .7rem .9rem; }
.big b { display: block; font-size: 1.2rem; font-weight: 600; white-space: nowrap; font-variant-numeric: tabular-nums; }
.big span { color: var(--soft); font-size: .84rem; }
.note { background: var(--tint); border-left: .25rem solid var(--mark); padding: .5rem .9rem; border-radius: .2rem; max-width: none; }
figure { margin: 1rem 0; } figure img { display: block; width: 100%; height: auto; }
.row { display: grid; gap: .5rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, var(--least)), 1fr)); }
.two { --least: 24rem; } .three { --least: 17rem; }
.lead { font-size: 1.15rem; }
summary { cursor: pointer; margin: .8rem 0; }
figcaption { margin-top: .4rem; max-width: 52rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; font-variant-numeric: tabular-nums; }
caption { text-align: left; caption-side: bottom; padding-top: .4rem; }
th, td { padding: .28rem .7rem .28rem 0; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th { font-weight: 600; } td:first-child { white-space: nowrap; } td:not(.n):not(:first-child) { min-width: 8rem; } td.n, th.n { text-align: right; white-space: nowrap; }
code { font: .84em ui-monospace, "SF Mono", Menlo, Consolas, monospace; overflow-wrap: anywhere; }
pre { background: var(--tint); padding: .7rem .9rem; border-radius: .4rem; overflow-x: auto; font-size: .84rem; white-space: pre-wrap; overflow-wrap: anywhere; }
@media print { body { max-width: none; } nav { display: none; } }
"""  # noqa: E501  # a rule per line is how one reads CSS


def page(title: str, body: Sequence[str]) -> str:
    """A whole page: its head, its style, the parts of its body."""
    head = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
    )
    return head + "\n".join(body) + "\n</body>\n</html>\n"


def write(path: Path, text: str) -> None:
    """Write a page whole or not at all: what lay there before stays until the new one is complete."""
    with whole(path) as fresh:
        fresh.write_text(text, encoding="utf-8", newline="\n")


def heading(text: str) -> str:
    """What the page is of."""
    return f"<h1>{escape(text)}</h1>"


def section(name: str, title: str, *parts: str) -> str:
    """A section that the contents line leads to."""
    return (
        f'<section id="{escape(name)}">\n<h2>{escape(title)}</h2>\n' + "\n".join(filter(None, parts)) + "\n</section>"
    )


def contents(sections: Mapping[str, str]) -> str:
    """The line of links to the sections, {name: title}."""
    links = (f'<a href="#{escape(name)}">{escape(title)}</a>' for name, title in sections.items())
    return f"<nav>{' '.join(links)}</nav>"


def escaped(text: str) -> str:
    """Text of others, which cannot be taken for markup."""
    return escape(text)


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def code(text: str) -> str:
    """A command line or a record, as a block."""
    return f"<pre>{escape(text)}</pre>"


def figure(svg: bytes, alt: str, caption: str, command: str = "") -> str:
    """A picture inside the page; its caption says what the error is and where it comes from."""
    return f"<figure>{_picture(svg, alt)}\n{_caption(caption, command)}</figure>"


def row(pictures: Mapping[str, bytes], beside: str, caption: str, command: str = "") -> str:
    """Pictures {what they show: SVG}, `beside` one another by "two" or "three" where there is room; one caption."""
    shown = "\n".join(_picture(svg, alt) for alt, svg in pictures.items())
    return f'<figure><div class="row {beside}">{shown}</div>\n{_caption(caption, command)}</figure>'


def folded(title: str, *parts: str) -> str:
    """What most readers pass over: its title, the rest at a click."""
    inside = "\n".join(filter(None, parts))
    return f"<details><summary>{escape(title)}</summary>\n{inside}\n</details>"


def table(heads: Row, rows: Sequence[Row], caption: str = "", words: int = 1, ending: int = 0) -> str:
    """A table; its first `words` and last `ending` columns hold words, the others numbers."""

    def line(cells: Row, tag: str) -> str:
        marked = (' class="n"' if words <= i < len(cells) - ending else "" for i in range(len(cells)))
        return (
            "<tr>"
            + "".join(f"<{tag}{c}>{escape(cell)}</{tag}>" for cell, c in zip(cells, marked, strict=True))
            + "</tr>"
        )

    body = "\n".join(line(row, "td") for row in rows)
    under = f'\n<p class="soft">{escape(caption)}</p>' if caption else ""
    return f'<div class="wide"><table><thead>{line(heads, "th")}</thead>\n<tbody>{body}</tbody></table></div>{under}'


def facts(rows: Sequence[tuple[str, str]], caption: str = "") -> str:
    """A table of names and what they are; what is long may break."""
    under = f"<caption>{escape(caption)}</caption>" if caption else ""
    body = "\n".join(f"<tr><th>{escape(name)}</th><td><code>{escape(value)}</code></td></tr>" for name, value in rows)
    return f'<div class="wide"><table>{under}<tbody>{body}</tbody></table></div>'


def highlights(rows: Sequence[tuple[str, str]]) -> str:
    """A few large numbers, each with what it is."""
    boxes = (f"<div><b>{escape(number)}</b><span>{escape(what)}</span></div>" for number, what in rows)
    return f'<div class="big">{"".join(boxes)}</div>'


def percent(one: Mapping[str, float] | None, digits: int = 2) -> str:
    """A share with its standard error, in percent."""
    if one is None:
        return NOTHING
    return f"{100.0 * one['value']:.{digits}f} ± {100.0 * one['standard_error']:.{digits}f} %"


def points(one: Mapping[str, float] | None) -> str:
    """A difference of two shares with its standard error, in points."""
    if one is None:
        return NOTHING
    return f"{100.0 * one['value']:+.2f} ± {100.0 * one['standard_error']:.2f}"


def lux(one: Mapping[str, float] | None) -> str:
    """An illuminance with its standard error."""
    return NOTHING if one is None else f"{one['value']:,.0f} ± {one['standard_error']:,.0f} lx"


def duration(seconds: float | None) -> str:
    """A time in the unit that suits it."""
    if seconds is None:
        return NOTHING
    for unit_s, name in ((86_400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit_s:
            return f"{seconds / unit_s:,.1f} {name}"
    return f"{seconds:,.1f} s"


def in_words(design: Mapping[str, Any]) -> str:
    """A design in a line."""
    names = ("distance_um", "width_um", "spacing_um", "thickness_um")
    lengths = ", ".join(f"{letter} {design[name]:g}" for letter, name in zip("DWST", names, strict=True))
    return f"{lengths} µm, {design['dbr_pairs']:g} pairs"


def _picture(svg: bytes, alt: str) -> str:
    inside = svg.decode().translate(IN_ADDRESS)
    return f'<img src="data:image/svg+xml,{inside}" alt="{escape(alt)}">'


def _caption(text: str, command: str) -> str:
    made = f" <br><code>{escape(command)}</code>" if command else ""
    return f"<figcaption>{escape(text)}{made}</figcaption>"
