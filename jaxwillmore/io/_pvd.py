"""The table of contents of a time series: which VTU file belongs to which time."""

import dataclasses
import os
import pathlib
import xml.etree.ElementTree
from xml.sax.saxutils import quoteattr

from ._atomic import atomic_write

_MAX_BYTES = 2**28


@dataclasses.dataclass(frozen=True)
class PvdSeries:
    """A `.pvd` file, ParaView's list of the frames of a run.

    The list lives in the file alone and is rewritten atomically by every `append`, so a run that
    is still going on, or was killed, can be opened at any moment.

    ```python
    series = PvdSeries("run.pvd")
    series.append(0.0, "frames/frame_000000.vtu")
    ```
    """

    path: str | os.PathLike[str]

    def entries(self) -> list[tuple[float, str]]:
        """Time and file of every frame, in the order in which they were written.

        **Raises:** `ValueError` when the file is not a list of frames.
        """
        path = pathlib.Path(self.path)
        if not path.exists():
            return []
        data = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else b""
        # entities are the known way to make a small XML file fill the memory
        if not data or b"<!" in data:
            raise ValueError(f"`{path}` is not a list of frames; move it away and start again.")
        try:
            root = xml.etree.ElementTree.fromstring(data)
            return [
                (float(entry.attrib["timestep"]), entry.attrib["file"])
                for entry in root.iter("DataSet")
            ]
        except (xml.etree.ElementTree.ParseError, KeyError, ValueError) as error:
            raise ValueError(f"`{path}` is not a list of frames ({error}).") from error

    def append(self, time: float, file: str) -> None:
        """Add a frame; `file` is relative to the folder of the `.pvd` file."""
        self._write([*self.entries(), (float(time), file)])

    def keep(self, count: int) -> list[str]:
        """Keep the first frames only, as a run that goes on must; the files of the others.

        These stay: the list forgets them first, so that it never names one that is gone.
        """
        entries = self.entries()
        if len(entries) < count:
            raise ValueError(f"`{self.path}` lists {len(entries)} frames; {count} were written.")
        if len(entries) > count:
            self._write(entries[:count])
        return [file for _, file in entries[count:]]

    def _write(self, entries: list[tuple[float, str]]) -> None:
        lines = [
            f'<DataSet timestep="{time!r}" part="0" file={quoteattr(file)}/>\n'
            for time, file in entries
        ]
        with atomic_write(self.path, "w") as stream:
            stream.write('<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n')
            stream.writelines(["<Collection>\n", *lines, "</Collection>\n</VTKFile>\n"])
