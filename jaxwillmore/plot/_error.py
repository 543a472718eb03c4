"""Why a picture could not be made."""


class PlotError(RuntimeError):
    """A picture could not be made; nothing else of a run depends on it."""


def matplotlib_figure(width: float, height: float):
    """An empty figure that belongs to no window and no global state.

    **Raises:** `PlotError` when matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PlotError(
            "pictures need matplotlib; install it with `pip install 'jaxwillmore[viz]'`."
        ) from error
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)  # puts itself into the figure
    return figure


def save(figure, path, dpi: float) -> None:
    """Write the figure as PNG.

    **Raises:** `PlotError` when the file cannot be written.
    """
    try:
        with open(path, "wb") as file:
            figure.savefig(file, format="png", dpi=dpi)
    except OSError as error:
        raise PlotError(f"cannot write the picture `{path}`: {error.strerror}.") from error
