"""Figures, their colours and their files: what all pictures share.

Matplotlib comes with the extra ``report`` and is imported when the first picture is drawn. Its
object interface keeps no global state, so PNG pictures can be drawn from any thread.
"""

import base64
import io
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from incremental_mapper.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_PX = 1600
HEIGHT_PX = 900
DPI = 100
PAGE_DPI = 160
"""Of the points in a page's pictures; screens with small pixels show more than 100."""
PNG_LEVEL = 3
"""How hard a PNG is compressed: the levels above take twice as long for 3 % of its size."""
FORMATS = ('.png', '.svg', '.pdf')


@dataclass(frozen=True, slots=True)
class Theme:
    """The colours of a picture by what they stand for.

    The colours of data are those of Okabe and Ito, which readers with any colour vision can tell
    apart, and lighter relatives of them on a dark ground.
    """

    ground: str = '#FFFFFF'
    ink: str = '#222222'
    muted: str = '#5F6368'
    frame: str = '#CCCCCC'
    grid: str = '#E6E6E6'
    truth: str = '#BDBDBD'
    blue: str = '#0072B2'
    vermillion: str = '#D55E00'
    purple: str = '#B65A93'
    sky: str = '#56B4E9'
    green: str = '#009E73'
    orange: str = '#E69F00'
    grey: str = '#8A8A8A'
    even: str = '#E4EDF5'
    odd: str = '#F3EEDF'
    edge: str = '#A9B7C4'
    node: str = '#FFFFFE'
    unconnected: str = '#FBD5D5'
    unconnected_edge: str = '#B2182B'

    @property
    def lidars(self) -> tuple[str, ...]:
        """Colours of the LiDARs in the order of their names."""
        return (self.blue, self.vermillion, self.purple, self.sky)


LIGHT = Theme()
DARK = Theme(
    ground='#14181D',
    ink='#E8EAED',
    muted='#A0A8B1',
    frame='#3D454E',
    grid='#272D34',
    truth='#5C656F',
    blue='#4FA8E0',
    vermillion='#F58549',
    purple='#DD8FBF',
    sky='#8FD3F7',
    green='#2CC49A',
    orange='#F2B53A',
    grey='#959DA6',
    even='#1E2D3C',
    odd='#312C1F',
    edge='#50606F',
    node='#14181E',
    unconnected='#5A1F24',
    unconnected_edge='#FF7B72',
)
THEMES = {'light': LIGHT, 'dark': DARK}
_ROLES = [field.name for field in fields(Theme)]
# Colours that stand for roles until a page replaces them by its own; nothing else has them.
_PAGE = {name: f'#01{index:02x}fe' for index, name in enumerate(_ROLES)}
PAGE = Theme(**_PAGE)
"""Draws in the colours of the page that the picture is put into; see ``svg_for_page``."""


@dataclass(frozen=True, slots=True)
class Look:
    """How a picture is drawn: colours, size in pixels, size of its text, and with a heading.

    Without one it is part of a page, which has the heading and the legend beside it.
    """

    theme: Theme = LIGHT
    width: int = WIDTH_PX
    height: int = HEIGHT_PX
    text: float = 12.0
    heading: bool = True


WHOLE = Look()
"""A picture for itself."""


def new_figure(look: Look) -> 'Figure':
    """An empty figure of a look's size and ground.

    Raises:
        OutputError: matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError(
            "pictures need matplotlib; install it with: pip install 'incremental_mapper[report]'"
        ) from error
    size = (look.width / DPI, look.height / DPI)
    figure = Figure(figsize=size, dpi=DPI, facecolor=look.theme.ground)
    FigureCanvasAgg(figure)
    return figure


def box(
    look: Look, left: int, bottom: int, right: int, top: int
) -> tuple[float, float, float, float]:
    """The rectangle of an axes, as matplotlib's ``add_axes`` takes it.

    Args:
        look: How the picture is drawn.
        left: Margin in pixels; so are the others.
        bottom: Margin below.
        right: Margin at the right.
        top: Margin above.

    Returns:
        Left, bottom, width and height as shares of the figure.
    """
    return (
        left / look.width,
        bottom / look.height,
        1.0 - (left + right) / look.width,
        1.0 - (bottom + top) / look.height,
    )


def axes_pixels(axes: 'Axes') -> tuple[float, float]:
    """Width and height of an axes in pixels."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    place, size = axes.get_position(), figure.get_size_inches()
    return float(place.width * size[0] * DPI), float(place.height * size[1] * DPI)


def save(figure: 'Figure', path: Path) -> None:
    """Write the figure as PNG, SVG or PDF, as the suffix says; the same one makes the same file.

    Raises:
        OutputError: The suffix is another, or the file cannot be written.
    """
    import matplotlib

    check_suffix(path)
    suffix = path.suffix.lower()
    try:
        if suffix == '.png':
            _save_png(figure, path)
        elif suffix == '.svg':
            with matplotlib.rc_context({'svg.hashsalt': 'incremental_mapper'}):
                figure.savefig(path, format='svg', dpi=DPI, metadata={'Date': None})
        else:
            figure.savefig(path, format='pdf', dpi=DPI, metadata={'CreationDate': None})
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error


def _save_png(figure: 'Figure', path: Path) -> None:
    """Without the opacity, which is full everywhere: smaller, and written in half the time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image  # which matplotlib needs too

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
    Image.fromarray(pixels).save(path, 'PNG', compress_level=PNG_LEVEL, dpi=(DPI, DPI))


def check_suffix(path: Path) -> None:
    """Check the name of a picture.

    Raises:
        OutputError: Its suffix is none of ``FORMATS``.
    """
    if path.suffix.lower() not in FORMATS:
        raise OutputError(
            f'{path}: has the suffix {path.suffix!r}; pictures are {", ".join(FORMATS)}'
        )


def svg_for_page(figure: 'Figure', name: str, label: str) -> str:
    """The figure, drawn with the theme ``PAGE``, as an SVG element to be put into a page.

    Its colours are the page's CSS variables ``--ground``, ``--ink`` and so on; its text stays
    text in the page's font.

    Args:
        figure: What was drawn.
        name: A name that no other picture of the page has, since names inside an SVG are seen in
            all of the page.
        label: What a reader is told who does not see the picture.

    Returns:
        The element ``<svg>``.
    """
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({'svg.fonttype': 'none', 'svg.hashsalt': name}):
        figure.savefig(
            buffer, format='svg', dpi=PAGE_DPI, transparent=True, metadata={'Date': None}
        )
    text = buffer.getvalue()
    text = text[text.index('<svg') :]
    text = re.sub(r'<metadata>.*?</metadata>', '', text, flags=re.DOTALL)
    text = re.sub(r'<!--.*?-->\s*', '', text, flags=re.DOTALL)
    text = re.sub(r' style="image-rendering:[^"]*"', '', text)  # pixels need not be seen
    for colour in _PAGE.values():
        text = text.replace(colour, css_colour(colour))
    text = re.sub(r"font: ([^;\"]*?)'DejaVu Sans'[^;\"]*", r'font: \1var(--font)', text)
    text = re.sub(r'(?<=data:image/png;base64,)[^"]+', _fewer_colours, text)
    for attribute in (r'(\bid=")', r'(xlink:href="#)', r'(url\(#)'):
        text = re.sub(attribute, rf'\g<1>{name}-', text)
    head = re.sub(r' (width|height|version)="[^"]*"', '', text[: text.index('>')])
    described = f'{head} role="img" aria-label="{_attribute(label)}"'
    return re.sub(r'\n\s*', '\n', described + text[text.index('>') :]).strip()


def css_colour(colour: str) -> str:
    """A colour of ``PAGE`` in CSS: the variable that holds it, such as ``var(--ink)``."""
    role = next(role for role, held in _PAGE.items() if held == colour)
    return f'var(--{_css_name(role)})'


def css_variables(theme: Theme) -> str:
    """The declarations that give a page the colours of a theme."""
    return ' '.join(f'--{_css_name(role)}: {getattr(theme, role)};' for role in _ROLES)


def title(figure: 'Figure', heading: str, facts: str, look: Look) -> None:
    """Write a heading into the upper left corner.

    Args:
        figure: The figure; one whose look has no heading stays as it is.
        heading: What the picture is.
        facts: What it shows, behind the heading in grey.
        look: How the picture is drawn.
    """
    if not look.heading:
        return
    height = 1.0 - 49.5 / look.height
    left = figure.text(0.06, height, heading, fontsize=17, fontweight='bold', color=look.theme.ink)
    end = left.get_window_extent().x1 / look.width
    figure.text(end + 0.012, height, facts, fontsize=13, color=look.theme.muted)


def plain(axes: 'Axes', look: Look) -> None:
    """Light frame, and labels in the colours of the theme."""
    theme = look.theme
    axes.set_axisbelow(True)
    axes.set_facecolor('none')
    axes.tick_params(colors=theme.muted, labelsize=look.text - 1, length=3)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_color(theme.ink)
        axis.label.set_fontsize(look.text)
    for spine in axes.spines.values():
        spine.set_color(theme.frame)


def add_legend(axes: 'Axes', look: Look) -> None:
    """A legend in a row above the data, which it does not cover."""
    axes.legend(
        loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=9, borderaxespad=0.2, borderpad=0.2,
        columnspacing=1.2, handletextpad=0.5, frameon=False, labelcolor=look.theme.ink,
        fontsize=look.text - 1,
    )  # fmt: skip


def _fewer_colours(match: re.Match[str]) -> str:
    """A PNG in base64 with at most 256 colours, if that is smaller: of points, a quarter is."""
    from PIL import Image  # which matplotlib needs too

    whole = base64.b64decode(match[0])
    buffer = io.BytesIO()
    picture = Image.open(io.BytesIO(whole)).convert('RGBA')
    picture.quantize(256, method=Image.Quantize.FASTOCTREE).save(buffer, 'PNG', optimize=True)
    smallest = min(whole, buffer.getvalue(), key=len)
    return base64.b64encode(smallest).decode('ascii')


def _css_name(role: str) -> str:
    return role.replace('_', '-')


def _attribute(text: str) -> str:
    return text.replace('&', '&amp;').replace('"', '&quot;').replace('<', '&lt;')
