"""A person who stands still, from pictures all around: silhouettes, hull, surface."""

from ._colours import vertex_colours as vertex_colours
from ._hull import Views as Views, person_place as person_place, visual_hull as visual_hull
from ._reconstruct import (
    Scan as Scan,
    overlaps as overlaps,
    reconstruct as reconstruct,
    refuse_few_views as refuse_few_views,
)
from ._surface import refine_surface as refine_surface
from ._sway import Sway as Sway
