from ._appearance import (
    Appearance as Appearance,
    AppearanceSettings as AppearanceSettings,
    appearance_preset as appearance_preset,
    fit_appearance as fit_appearance,
)
from ._background import (
    BackgroundModel as BackgroundModel,
    background_distance as background_distance,
    fit_background as fit_background,
    nearest_selected as nearest_selected,
)
from ._background_grid import (
    GridSettings as GridSettings,
    grid_ids as grid_ids,
    grid_triangles as grid_triangles,
    grid_vertices as grid_vertices,
    similarity_residuals as similarity_residuals,
)
from ._colour_model import (
    TAU as TAU,
    ColourModel as ColourModel,
    ColourSettings as ColourSettings,
    distance as distance,
    psi as psi,
    whitening as whitening,
)
from ._fit_colours import fit_colour_models as fit_colour_models
from ._foreground import (
    ForegroundModel as ForegroundModel,
    ForegroundSettings as ForegroundSettings,
    fit_foreground as fit_foreground,
)
from ._palette import (
    Palette as Palette,
    fit_palette as fit_palette,
    label_image as label_image,
    palette_from_colours as palette_from_colours,
    psi_table as psi_table,
)
from ._plate import (
    Plate as Plate,
    PlateSettings as PlateSettings,
    grid_coordinates as grid_coordinates,
    plate_beside as plate_beside,
    plate_distance as plate_distance,
    renewed_plate as renewed_plate,
    warped_plate as warped_plate,
)
from ._warp import GridWarp as GridWarp, WarpSettings as WarpSettings, warp_grid as warp_grid
