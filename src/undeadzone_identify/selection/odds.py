"""Posterior probabilities of all models that remain valid although every model is slightly wrong.

By the densities of a log, penalised by BIC, one of many models soon has all odds, and in a second
log of the same machine another one. So the odds are the mean over logs that might have been
recorded as well (bagged posteriors: Huggins and Miller 2023): the sum of the differences between
two models' log densities scatters over such logs as its cosines do (I1), whatever the colour of
what the models leave.

Beforehand a plant without a zone is as likely as all that may be there together, so that the more
is asked the less is found by chance (Scott and Berger 2010).

References:
    J. G. Scott, J. O. Berger (2010), doi:10.1214/10-AOS792
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.special import softmax

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import draw_sums
from undeadzone_identify.models.least_squares import Density

DRAWS = 2000
Family = Mapping[str, Density]  # models of the same readings, by word; one of them is "none"


def model_probabilities(
    families: Sequence[Family], excluded: Collection[str] = ()
) -> dict[str, float]:
    """Return the posterior probabilities of the classes, largest first [1].

    Args:
        families: models of the same readings; the readings of another family may be others.
        excluded: words that are out of the question.
    """
    least = min((family["none"] for family in families), key=lambda one: one.value.size)
    scores: dict[str, Floats] = {}
    for family in families:
        for word, drawn in zip(family, _draw_log_odds(family, least).T, strict=True):
            if word not in excluded:
                scores[word] = np.maximum(scores.get(word, -math.inf), drawn)
    words = list(scores)
    choice = math.log(max(len(words) - 1, 1)) * (np.array(words) != "none")
    shares = softmax(np.array(list(scores.values())) - choice[:, None], axis=0).mean(axis=1)
    return {words[k]: float(shares[k]) for k in np.argsort(-shares)}


def _draw_log_odds(family: Family, least: Density) -> Floats:
    """Draw log odds against no zone, for logs as short as the least family's (DRAWS x K)."""
    count = least.value.size
    none = least if family["none"].value.size == count else family["none"]
    gains = np.column_stack([one.value - none.value for one in family.values()])
    numbers = np.array([one.numbers - none.numbers for one in family.values()])
    return count / len(gains) * draw_sums(gains, DRAWS) - 0.5 * numbers * math.log(count)


def nats_behind_best(families: Sequence[Family]) -> dict[str, float]:
    """Return the nats per reading by which each model is behind the best, by class.

    Args:
        families: as for `model_probabilities`.
    """
    gained: dict[str, float] = {}
    for family in families:
        for word, one in family.items():
            gain = (family["none"].bic - one.bic) / (2 * one.value.size)
            gained[word] = max(gain, gained.get(word, -math.inf))
    return {word: max(gained.values()) - gain for word, gain in gained.items()}
