"""The curves of the viewer's page: energy, confidence and uncertainty along the time line."""

from typing import Any

import numpy as np

from jaxmocap.motion import Motion

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8c6d00", "#56a0d0")


class Curves:
    """Plots of a motion; `plots` are viser's handles, each with its curves."""

    def __init__(self, server: Any, motion: Motion):
        self._server, self._frames = server, motion.frames.astype(np.float64)
        self.plots: list[tuple[Any, list[np.ndarray]]] = []
        known = [(name, values) for name, values in motion.energy.items() if np.isfinite(values).any()]
        relative = {name: values / max(float(np.nanmedian(np.abs(values))), 1e-9) for name, values in known}
        if relative:
            self._add("Energy by term, over its median", relative)
        self._add("Confidence, mean over joints", {"confidence": motion.confidence.mean(axis=1)})
        deviations = motion.joint_deviations
        if deviations is not None:
            self._add("Uncertainty, median over joints, cm", {"deviation": 100 * np.median(deviations, axis=1)})

    def mark(self, index: int) -> None:
        """Show a spike at a position of the motion."""
        for plot, values in self.plots:
            now = np.full(len(self._frames), np.min(values))
            now[index] = np.max(values)
            plot.data = (self._frames, *values, now)

    def _add(self, title: str, curves: dict[str, np.ndarray]) -> None:
        series: list[dict[str, Any]] = [{"label": "frame"}]
        for number, name in enumerate(curves):
            series.append({"label": name, "stroke": _COLOURS[number % len(_COLOURS)], "width": 1.5})
        series.append({"label": "now", "stroke": "#888888", "width": 1})
        values = [_filled(np.asarray(curve, np.float64)) for curve in curves.values()]
        data = (self._frames, *values, np.zeros(len(self._frames)))
        with self._server.gui.add_folder(title):
            plot = self._server.gui.add_uplot(
                data, tuple(series), scales={"x": {"time": False}}, legend={"show": len(curves) > 1}, aspect=1.8
            )
        self.plots.append((plot, values))


def _filled(values: np.ndarray) -> np.ndarray:
    """Bridge gaps by straight lines: the plots of the page go blank over a NaN."""
    known = np.isfinite(values)
    places = np.arange(len(values))
    return np.interp(places, places[known], values[known])
