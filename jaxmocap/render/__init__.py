from ._coverage import covered_area as covered_area
from ._draw import draw as draw, draw_one_by_one as draw_one_by_one, draw_scatter as draw_scatter
from ._expand import (
    Driver as Driver,
    best_driver as best_driver,
    corner as corner,
    expand as expand,
    expand_one_by_one as expand_one_by_one,
    listed as listed,
    look_up as look_up,
)
from ._face_ids import (
    face_ids as face_ids,
    inverse_depth_range as inverse_depth_range,
    projection_matrices as projection_matrices,
)
from ._keys import WINDOW as WINDOW, KeyLayout as KeyLayout, crop as crop, empty_buffer as empty_buffer
from ._ray_visibility import (
    RaySamples as RaySamples,
    on_rays as on_rays,
    quantile_samples as quantile_samples,
    transmittance as transmittance,
    visibilities as visibilities,
)
from ._soft_faces import SoftFaces as SoftFaces, SoftSettings as SoftSettings, soft_faces as soft_faces
from ._tiles import (
    Tiles as Tiles,
    block_sums as block_sums,
    dirty_tiles as dirty_tiles,
    put_back as put_back,
    sum_over_blocks as sum_over_blocks,
    sum_over_tiles as sum_over_tiles,
    tiles_at as tiles_at,
    touched_rows as touched_rows,
)
from ._windows import (
    BEHIND as BEHIND,
    Faces as Faces,
    Places as Places,
    WindowList as WindowList,
    Windows as Windows,
    doubled_area as doubled_area,
    planned_windows as planned_windows,
    to_screen as to_screen,
    window_list as window_list,
)
