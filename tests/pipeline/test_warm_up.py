"""What is compiled ahead is what another film asks for."""

import jax
import pytest

from jaxmocap.pipeline import track_capture, warm_up
from jaxmocap.synthetic import make_capture, write_capture

LARGE = {"_search", "_prepare", "_score", "contour_lines", "normal_equations", "damped_step", "sum_of_squares"}


@pytest.mark.slow
def test_another_film_compiles_none_of_the_large_programs(tmp_path):
    """A person of another height, who moves otherwise, seen from elsewhere."""
    compiled: list[str] = []

    def listen(event: str, duration_secs: float, **about: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(str(about["fun_name"]).removeprefix("jit(").removesuffix(")"))

    film = make_capture(5, (960, 540), seed=3, height=1.62, routine="crossing arms", view_angle_degrees=40.0)
    write_capture(film, tmp_path / "film")
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        assert warm_up() > 0
        assert set(compiled) >= LARGE
        compiled.clear()
        track_capture(tmp_path / "film", tmp_path / "result", detections=tmp_path / "film/keypoints", overlays=False)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert LARGE & set(compiled) == set()
