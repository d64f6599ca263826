"""What the rays of the radiance map are asked, round by round: where surfaces are, then their light."""

from __future__ import annotations

from dataclasses import dataclass

ROUNDS = 3  # of paths at most
MOST_QUESTIONS = ROUNDS + 2  # those of light, and one of cells and of textures each


@dataclass(frozen=True)
class Question:
    """What rays through all pixels are asked.

    Attributes
    ----------
    kind : {'cells', 'light', 'textures'}
        Which cells hold a surface, what light it sends, or only what it reflects.
    passes : int
        Rays of a pixel.
    before : int
        Number of the first of them.
    share : float
        Of what is left to be done, roughly.
    """

    kind: str
    passes: int
    before: int
    share: float
