"""How pictures of pages look: colours and letters; the same document gives the same bytes, on light paper or dark.

A page shows its pictures as SVG without a background. Ink and colours that would drown on dark paper are changed
there by the picture's own style, so a picture follows the page that it stands in.
"""

from __future__ import annotations

import re
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from luxloop.files import whole

INK, BLUE, ORANGE, GREEN, GREY = "#1d2430", "#0b62a8", "#d9730d", "#2f8f5b", "#8a94a3"
COLOURS = (INK, BLUE, ORANGE, GREEN, "#8c4fb8", "#c2334d", "#8a6d1f", "#3aa6a6")
"""Of several curves, told apart on light and on dark paper."""
PAPER, SHADE = "#fefefe", "#ebebeb"
"""What lies beneath a legend, and what marks a range."""
LOOK: Any = {  # matplotlib's own type lists every key there is
    "svg.fonttype": "none",  # letters as text: a third of the size
    "svg.hashsalt": "luxloop",
    "text.parse_math": False,  # a $ in somebody's name is a $
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "grid.color": GREY,
    "legend.edgecolor": "none",
    "legend.facecolor": PAPER,
    "legend.framealpha": 0.85,
    "legend.fontsize": 8.0,
    "xtick.color": INK,
    "ytick.color": INK,
}
PLAIN: Any = {"text.parse_math": LOOK["text.parse_math"]}
"""For pictures that else look as matplotlib's do."""
TEXT = LOOK | {"font.size": 8.0, "axes.titlesize": 8.5, "legend.fontsize": 7.5}
"""The same for small pictures, of which several stand side by side."""
MIDDLE = (4.6, 3.1)
PIXELS_FROM = 300  # points; more are drawn as pixels
DPI = 110

ON_DARK = {
    INK: "#e4e8ee",
    BLUE: "#6db7f2",
    ORANGE: "#f0954a",
    GREEN: "#5fc48c",
    PAPER: "#151a21",
    SHADE: "#2b333e",
    "#8c4fb8": "#b98be0",
}
"""Light paper's colour: what it is on dark paper."""
COORDINATES = re.compile(rb' (?:d|x|y)="[^"]*"')
DECIMALS = re.compile(rb"(\.\d\d)\d+")
"""Coordinates are kept to 0.01 points: half the size, and nobody sees it."""
FONTS = re.compile(rb"font-family: [^;\"]*")
PNG = re.compile(rb'base64,([^"]*)"')


def svg(figure: Figure) -> bytes:
    """The picture for a page: no date, no random names, no background, and colours for dark paper."""
    memory = BytesIO()
    figure.savefig(memory, format="svg", dpi=DPI, facecolor="none", metadata={"Date": None, "Creator": None})
    drawn = COORDINATES.sub(lambda found: DECIMALS.sub(rb"\1", found[0]), memory.getvalue())
    drawn = FONTS.sub(b"font-family: 'DejaVu Sans', Verdana, sans-serif", drawn)
    drawn = PNG.sub(lambda found: b"base64," + b64encode(_few_colours(b64decode(found[1]))) + b'"', drawn)
    return drawn.replace(b"</style>", _dark().encode() + b"</style>", 1)


def save(figure: Figure, path: Path) -> None:
    """Write the picture on white, as PNG, SVG or PDF by the name's ending; the same document gives the same bytes."""
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    with rc_context(LOOK), whole(path) as fresh:
        figure.savefig(fresh, dpi=130, facecolor="white", metadata=undated)


def _dark() -> str:
    rules = (
        f'[style*="{part}: {light}"]{{{part}:{dark}!important}}'
        for light, dark in ON_DARK.items()
        for part in ("fill", "stroke")
    )
    return f"@media (prefers-color-scheme: dark){{{''.join(rules)}}}"


def _few_colours(png: bytes) -> bytes:
    """The same pixels with a palette where they have at most 256 colours and none is transparent: a third of it."""
    pixels = np.asarray(Image.open(BytesIO(png)).convert("RGBA"))
    words = np.ascontiguousarray(pixels).view(">u4").astype(np.uint32)  # numbers are sorted faster than rows
    found, number = np.unique(words, return_inverse=True)
    colours = found.astype(">u4").view(np.uint8).reshape(-1, 4)
    if len(colours) > 256 or colours[:, 3].min() < 255:
        return png
    smaller = Image.fromarray(number.reshape(pixels.shape[:2]).astype(np.uint8), mode="P")
    smaller.putpalette(colours[:, :3].tobytes())
    file = BytesIO()
    smaller.save(file, format="png", optimize=True)
    return file.getvalue()
