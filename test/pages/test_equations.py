"""Equations become MathML; what cannot be converted ends the build."""

import equations
import pytest
from fontTools.ttLib import TTFont


def test_inline_and_block_become_mathml_with_their_number() -> None:
    page = (
        r'<p>Of <span class="arithmatex">\(N - 1\)</span> gaps</p>'
        r'<div class="arithmatex">\[a &lt; b \tag{7}\]</div>'
    )
    made = equations.with_equations(page)
    assert 'arithmatex' not in made
    assert made.count('<math ') == 2
    assert 'display="inline"' in made
    assert 'display="block"' in made
    assert '<span class="number">(7)</span>' in made
    assert r'\tag' not in made
    assert '<mo>&#x0003C;</mo>' in made


def test_an_equation_is_read_out_as_it_was_written() -> None:
    made = equations.with_equations(r'<span class="arithmatex">\(a &lt; "b"\)</span>')
    assert 'aria-label="a &lt; &quot;b&quot;"' in made


@pytest.mark.parametrize(
    'formula', [r'\notacommand x', r'\frac{1', r'\begin{aligned} a &= b \end{aligned}']
)
def test_what_cannot_be_converted_is_told(formula: str) -> None:
    page = rf'<div class="arithmatex">\[{formula}\]</div>'
    with pytest.raises(equations.MathError):
        equations.with_equations(page)


def test_the_font_has_what_equations_need(tmp_path) -> None:
    path = tmp_path / 'assets' / 'font.woff'
    equations.write_font(path)
    font = TTFont(path)
    assert 'MATH' in font
    letters = font.getBestCmap()
    assert all(ord(letter) in letters for letter in 'xΣ∑√⊕λ‖𝑥')
