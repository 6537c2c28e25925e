"""Numbers, units and formulas as a reader sees them."""

import xml.etree.ElementTree as ET

import numpy as np

from erosion.report.text import degrees, formula, math, number, quantity


def test_numbers_read_well() -> None:
    plain = str.maketrans("\N{NO-BREAK SPACE}", " ")
    assert number(1.81643635e-4).translate(plain) == "1.8164 × 10⁻⁴"
    assert number(-752.4442) == "−752.44"
    assert number(99999.96, 5).translate(plain) == "100000"
    assert number(0.0) == number(-0.0) == "0"
    assert number(200e3, 7, strip=True) == "200000"
    assert number(3.01e-11, 1, up=True).translate(plain) == "4 × 10⁻¹¹"
    assert number(3e-11, 1, up=True).translate(plain) == "3 × 10⁻¹¹"
    assert number(0.1, 1, up=True) == "0.1"  # though the float is slightly above
    assert number(200e3, 6, strip=True) == "200000"
    assert number(2.855e-7, 7, strip=True).translate(plain) == "2.855 × 10⁻⁷"
    assert number(-1.5e9, tex=True) == r"-1.5000\times 10^{9}"
    assert quantity(6.635e-5, "time", "si", like=6.6e-5).translate(plain) == "66.350 µs"
    assert quantity(6.635e-5, "time", "si").translate(plain) == "6.6350 × 10⁻⁵ s"
    assert quantity(2e-4, "volume", "inch-pound", 2, tex=True) == r"2.0\times 10^{-4}\,\text{in}^{3}"
    assert degrees(np.deg2rad(20)) == "20°"
    assert degrees(np.arctan(2) / 2) == "31.717°"


def test_formulas_are_sound_mathml() -> None:
    for tex in (r"k\cot\alpha=\pm\dot{x}/2", r"\begin{align*} a&=b\\c&=d\end{align*}", r"\sin^2\alpha\left(1\right)"):
        root = ET.fromstring(math(tex))
        assert root.tag.endswith("math")
    assert "<mo>&#x000B1;</mo>" in math(r"\pm")
    assert math(r"k\sin x").count("<mspace") == 2
    assert math(r"\cdot\sin(x)").count("<mspace") == 0
    assert formula("x").startswith('<div class="math"')
