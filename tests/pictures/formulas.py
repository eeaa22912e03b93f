"""Draws the formulas of the panels' help from their TeX: ``python -m tests.pictures.formulas``.

Each becomes ``static/help/<panel>.svg``: outlines alone, so that no font is needed, in the colour
of the text around it. The number at a line's end is that of the equation in Xu 2024.
"""

import html
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath

FOLDER = Path(__file__).parents[2] / "static" / "help"
_EM = 250.0
# Letters of a formula are finer than those of the text beside it.
_SIZE = 1.15
_GAP = 0.55 * _EM
_MARGIN = 0.1 * _EM
_LETTERS = {Outline.MOVETO: "M", Outline.LINETO: "L", Outline.CURVE3: "Q", Outline.CURVE4: "C"}


@dataclass(frozen=True, slots=True)
class Formula:
    """TeX of each line with the number of its equation, and the same in words."""

    lines: tuple[tuple[str, str], ...]
    words: str


FORMULAS = {
    "recording": Formula(
        ((r"j(i)=\arg\min_{j}\;|\,t^{D}_{i}-\tau-t^{L}_{j}\,|", ""),),
        "Scan j of image i is the one with the least difference between the image's stamp, less "
        "the clock offset tau, and the scan's stamp.",
    ),
    "match": Formula(
        (
            (r"(u,v)=\arg\max\ \mathrm{sim}(D_{v},\hat{L}_{u})", "(1)"),
            (
                r"\mathrm{pearson}=\dfrac{\mathrm{Cov}(D_{v},\hat{L}_{u})}"
                r"{\sqrt{\mathrm{Var}(D_{v})\,\mathrm{Var}(\hat{L}_{u})}}",
                "(2)",
            ),
            (
                r"\mathrm{cosine}=\dfrac{D_{v}\cdot\hat{L}_{u}}{\|D_{v}\|\,\|\hat{L}_{u}\|}",
                r"in\ (3)",
            ),
            (
                r"\mathrm{euclidean}=1-\dfrac{\|D_{v}-\hat{L}_{u}\|}"
                r"{\max(\|D_{v}\|,\|\hat{L}_{u}\|)}",
                "(4)",
            ),
        ),
        "u and v are where the similarity of depth row D v and LiDAR segment L u is greatest. "
        "Pearson: their covariance over the root of the product of their variances. Cosine: their "
        "dot product over the product of their lengths. Euclidean: one less the length of their "
        "difference over the greater of their lengths.",
    ),
    "register": Formula(
        (
            (r"\hat{L}\,A=D", "(5)"),
            (
                r"E=\dfrac{1}{W}\,\sum_{i=1}^{W}\,\|\hat{L}_{i}\,A-D_{i}\|",
                "§3.2.2",
            ),
        ),
        "The LiDAR's points L times the map A are the depth points D. E is the mean distance "
        "between the two over the W pairs.",
    ),
    "repair": Formula(
        (
            (r"\|\hat{L}_{\beta}\,A-D_{\beta}\|>\varepsilon", "(6)"),
            (r"\hat{L}_{\alpha}=D_{\alpha}\,A^{-1}", "(7)"),
            (r"D_{\alpha}=\hat{L}_{\alpha}\,A", "(8)"),
        ),
        "A pair is noise where its residual exceeds epsilon. The LiDAR is repaired from the depth "
        "image by the inverse of A, the depth image from the LiDAR by A.",
    ),
    "review": Formula(
        ((r"\kappa=\dfrac{p_{o}-p_{e}}{1-p_{e}}", ""),),
        "Kappa is the observed agreement less the one expected by chance, over one less the one "
        "expected by chance.",
    ),
    "map": Formula(
        (
            (r"p_{\mathrm{map}}=T_{\mathrm{map,\,lidar}}\;p_{\mathrm{lidar}}", ""),
            (r"\ell\,\leftarrow\,\ell+\log\,\dfrac{p}{1-p}", ""),
            (r"N_{\mathrm{eff}}=1\,/\,\sum_{i}\,w_{i}^{2}", ""),
            (r"x^{*}=\arg\min_{x}\;\sum_{i,j}\,e_{ij}^{T}\,\Omega_{ij}\,e_{ij}", ""),
        ),
        "A point in the map is the pose of the LiDAR times the point in the scan. A cell's log "
        "odds grow by the log of p over one less p. The effective number of particles is one over "
        "the sum of their squared weights. The poses x are those for which the errors e of all "
        "edges, squared and weighted by their information Omega, have the least sum.",
    ),
    "calibrate": Formula(
        (
            (
                r"z\,\left(u,\,v,\,1\right)^{T}=K\,\left(R\,p_{\mathrm{lidar}}+t\right)",
                "",
            ),
            (r"|\,D(u,v)-z\,|\,\leq\,3\,\mathrm{cm}+0.02\,r", ""),
        ),
        "A point of the LiDAR, turned by R and moved by t into the camera and multiplied by the "
        "camera's matrix K, is z times the pixel u, v. It agrees where the image's depth D at that "
        "pixel differs from z by at most 3 centimetres and 2 percent of the range r.",
    ),
}


def svg_of(formula: Formula) -> str:
    """A formula as an SVG of its own, its lines below each other and their numbers at the right."""
    bodies = [_outline(tex) for tex, _ in formula.lines]
    numbers = [_outline(rf"\mathrm{{{number}}}") if number else None for _, number in formula.lines]
    width = max(body.get_extents().x1 for body in bodies)
    if any(numbers):
        width += _EM + max(number.get_extents().x1 for number in numbers if number)
    parts, at = [], _MARGIN
    for body, number in zip(bodies, numbers, strict=True):
        box = body.get_extents()
        baseline = at + box.y1
        parts.append(_moved(body, _MARGIN, baseline))
        if number:
            parts.append(_moved(number, _MARGIN + width - number.get_extents().x1, baseline))
        at = baseline - box.y0 + _GAP
    width, height = width + 2 * _MARGIN, at - _GAP + _MARGIN
    words = html.escape(formula.words)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{words}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" width="{_SIZE * width / _EM:.2f}em" '
        'style="display:block;max-width:100%;margin:0.6em 0" fill="currentColor">'
        f'<path d="{"".join(parts)}"/></svg>\n'
    )


def _outline(tex: str) -> Outline:
    font = FontProperties(math_fontfamily="stix")
    return TextPath((0.0, 0.0), f"${tex}$", size=_EM, prop=font)


def _moved(outline: Outline, x: float, baseline: float) -> str:
    """The path data of an outline at its place; SVG counts y downwards."""
    data = []
    for points, code in outline.iter_segments(simplify=False, curves=True):
        if code == Outline.CLOSEPOLY:
            data.append("Z")
            continue
        pairs = np.reshape(points, (-1, 2)) * (1.0, -1.0) + (x, baseline)
        data.append(_LETTERS[code] + " ".join(f"{value:.0f}" for value in pairs.ravel()))
    return "".join(data)


def main() -> None:
    """Write every formula's file."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for panel, formula in FORMULAS.items():
        (FOLDER / f"{panel}.svg").write_text(svg_of(formula), encoding="utf-8")
        print(FOLDER / f"{panel}.svg")


if __name__ == "__main__":
    main()
