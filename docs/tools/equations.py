"""Equations as MathML, made while the site is built: no script and no network when it is read."""

import html
import re
from importlib.util import find_spec
from pathlib import Path

from latex2mathml.converter import convert

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
TAG = re.compile(r'\\tag\{([^}]*)\}')
UNKNOWN = re.compile(r'<m[a-z]+[^>]*>(\\[^<]*|&)</m')
CHARACTERS = (0x20, 0x17F), (0x370, 0x3FF), (0x2000, 0x22FF), (0x27E0, 0x27FF), (0x1D400, 0x1D7FF)
"""Ranges of the font that the site takes along."""


class MathError(ValueError):
    """An equation that cannot be converted."""


def with_equations(page: str) -> str:
    r"""HTML with the equations of the arithmatex extension turned into MathML.

    A ``\tag{3}`` in a block becomes the number at its right. Raises MathError.
    """
    return INLINE.sub(_inline, BLOCK.sub(_block, page))


def write_font(path: Path) -> None:
    """STIX Two Math (SIL Open Font License), without the characters that no page uses."""
    from fontTools.subset import Options, Subsetter
    from fontTools.ttLib import TTFont

    # Importing the package that brings the font would only cost time.
    package = find_spec('ziamath')
    if package is None or package.origin is None:
        raise MathError('ziamath, which brings the font, is not installed')
    font = TTFont(Path(package.origin).parent / 'fonts' / 'STIXTwoMath-Regular.ttf')
    subsetter = Subsetter(Options(layout_features=['dtls', 'flac', 'ssty'], notdef_outline=True))
    subsetter.populate(unicodes=[c for low, high in CHARACTERS for c in range(low, high + 1)])
    subsetter.subset(font)
    font.flavor = 'woff'
    path.parent.mkdir(parents=True, exist_ok=True)
    font.save(path)


def _inline(match: re.Match[str]) -> str:
    return _mathml(match.group(1), 'inline')


def _block(match: re.Match[str]) -> str:
    formula = match.group(1)
    tag = TAG.search(formula)
    number = f'<span class="number">({html.escape(tag.group(1))})</span>' if tag else ''
    mathml = _mathml(TAG.sub('', formula).strip(), 'block')
    return f'<div class="equation"><div class="formula">{mathml}</div>{number}</div>'


def _mathml(formula: str, display: str) -> str:
    text = html.unescape(formula)
    braces = re.findall(r'(?<!\\)[{}]', text)
    if braces.count('{') != braces.count('}'):
        raise MathError(f'{text!r}: a brace is open')
    try:
        mathml = convert(text, display=display)
    # The converter raises errors of many kinds.
    except Exception as error:
        raise MathError(f'{text!r}: {type(error).__name__} {error}') from error
    # What the converter does not know it passes through.
    unknown = UNKNOWN.search(mathml)
    if unknown:
        raise MathError(f'{text!r}: {unknown.group(1)!r} has no counterpart in MathML')
    label = html.escape(' '.join(text.split()), quote=True)
    return mathml.replace('<math ', f'<math aria-label="{label}" ', 1)
