"""Values published in the paper *MiniVLA-Nav v1*, each with its table, figure or section. Data only."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from factory.stats.statistics import Fit, Published
from schemas.instruction.templates import TEMPLATES, needs_colour
from schemas.terms import Split, Tier

_SCENES, _SPLITS, _TIERS = "Table V, Sec. V-E", "Table VI", "Table VII, Fig. 2"

OVERALL = Published(
    source=_SPLITS,
    n=1174,
    ne_mean_m=0.967,
    tl_mean_m=2.74,
    tl_median_m=2.38,
    steps_mean=200.9,
    steps_median=177,
)

SCENES = MappingProxyType(
    {
        "office": Published(source=_SCENES, n=700, tl_mean_m=2.66, steps_median=156),
        "hospital": Published(source=_SCENES, n=52, tl_mean_m=2.73, steps_median=160),
        "full_warehouse": Published(source=_SCENES, n=354, tl_mean_m=2.83, steps_median=207),
        "warehouse_multiple_shelves": Published(source=_SCENES, n=68, tl_mean_m=3.15, steps_median=189),
    }
)


def _split(n: int, ne: float, tl: tuple[float, float], steps: tuple[float, float]) -> Published:
    return Published(
        source=_SPLITS,
        n=n,
        ne_mean_m=ne,
        tl_mean_m=tl[0],
        tl_median_m=tl[1],
        steps_mean=steps[0],
        steps_median=steps[1],
    )


SPLITS: Mapping[str, Published] = MappingProxyType(
    {
        Split.TRAIN_ID: _split(716, 0.967, (2.70, 2.35), (195.9, 173)),
        Split.VAL_ID: _split(114, 0.969, (2.93, 2.70), (211.1, 197)),
        Split.TEST_ID: _split(121, 0.967, (2.85, 2.34), (210.9, 172)),
        Split.TEST_PARAPHRASE_OOD: _split(122, 0.965, (2.87, 2.39), (223.3, 195)),
        Split.TEST_OOD_OBJ: _split(101, 0.969, (2.54, 2.24), (186.0, 170)),
    }
)

TIERS: Mapping[str, Published] = MappingProxyType(
    {
        Tier.NEAR: Published(source=_TIERS, n=640, ne_mean_m=0.967, tl_mean_m=1.56, steps_mean=128.5, share=0.545),
        Tier.MID: Published(source=_TIERS, n=520, ne_mean_m=0.967, tl_mean_m=4.14, steps_mean=284.3, share=0.443),
        Tier.FAR: Published(source=_TIERS, n=14, ne_mean_m=0.970, tl_mean_m=4.46, steps_mean=414.6, share=0.012),
    }
)

_CATEGORIES, _IMBALANCE = "Fig. 6, Sec. VIII", "Sec. VIII"
CATEGORIES = MappingProxyType(
    {
        "monitor": Published(source=_CATEGORIES, n=339, share=0.289),
        "rack": Published(source=_CATEGORIES, n=258, share=0.220),
        "crate": Published(source=_IMBALANCE, share=0.112),
    }
)
"""Counts and shares that the paper prints. It prints no values for the other categories in its figure."""
THREE_LARGEST_SHARE = 0.621
"""Share of monitor, rack and crate in all episodes (Sec. VIII)."""

TEMPLATE_COUNTS = MappingProxyType({key: Published(source="Fig. 12", n=0) for key in TEMPLATES if needs_colour(key)})
"""Templates with a colour slot have no episodes in the paper. It prints no values for the other templates."""

_RATES = "Sec. V-A"
ATTEMPTS = MappingProxyType(
    {
        "office": Published(source=_RATES, rate=(0.8, 0.9)),
        "hospital": Published(source=_RATES, rate=(0.4, 0.6)),
        "full_warehouse": Published(source=_RATES, rate=(0.4, 0.6)),
    }
)

FIT = Fit(group="paper", n=1174, r=0.94, low=0.93, high=0.95, p=0.001, slope=1.00, slope_error=None, intercept_m=None)
"""Sec. V-F and Fig. 11; the paper gives p as an upper bound."""

NAVIGATION_ERROR = Published(source="Table VI, Fig. 8, Sec. IX", ne_mean_m=0.967, ne_std_m=0.001)
