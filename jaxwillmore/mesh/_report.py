"""What a check of a surface has to say."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from ._noise import Scatter
from ._quality import Quality

Severity = Literal["error", "warning"]
Index = int | tuple[int, ...]


@dataclass(frozen=True)
class Finding:
    """One kind of defect: how often, where, and what to do about it."""

    kind: str
    """A name such as `open_edges`."""
    severity: Severity
    """An `error` makes a simulation impossible or meaningless, a `warning` does not."""
    count: int
    """How many there are."""
    indices: tuple[Index, ...]
    """The worst ten: vertex or face numbers, or pairs of vertices for edges."""
    message: str
    """What is wrong, in one sentence."""
    advice: str
    """What to do."""

    def __str__(self) -> str:
        where = ""
        if self.indices:
            more = ", ..." if self.count > len(self.indices) else ""
            where = f"\n    where: {', '.join(map(str, self.indices))}{more}"
        head = f"{self.severity}: {self.kind} ({self.count})"
        return f"{head}\n    {self.message}{where}\n    {self.advice}"


class SurfaceError(ValueError):
    """A surface cannot be used; `report` lists the findings if it got as far as a check."""

    report: "SurfaceReport | None"

    def __init__(self, message: str, report: "SurfaceReport | None" = None):
        ValueError.__init__(self, message)
        self.report = report


class SurfaceReport(NamedTuple):
    """The findings of a check and the numbers that could be computed in spite of them."""

    findings: tuple[Finding, ...]
    n_vertices: int
    n_faces: int
    euler_characteristic: int | None = None
    n_components: int | None = None
    area: float | None = None
    volume: float | None = None
    quality: Quality | None = None
    scatter: Scatter | None = None

    @property
    def errors(self) -> tuple[Finding, ...]:
        """The findings that forbid a simulation."""
        return tuple(f for f in self.findings if f.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The findings that do not."""
        return tuple(f for f in self.findings if f.severity == "warning")

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of all findings, in the order of the report."""
        return tuple(f.kind for f in self.findings)

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not self.errors

    def raise_if_bad(self) -> "SurfaceReport":
        """Return the report.

        **Raises:** `SurfaceError`, a `ValueError` that carries the report, if there is an error.
        """
        if not self.ok:
            raise SurfaceError(str(self), self)
        return self

    def __str__(self) -> str:
        lines = [f"{self.n_vertices} vertices, {self.n_faces or 'no usable'} triangles"]
        if self.euler_characteristic is not None:
            lines[0] += f", Euler characteristic {self.euler_characteristic}"
        if self.n_components is not None:
            lines[0] += f", components: {self.n_components}"
        if self.area is not None and self.volume is not None:
            lines.append(f"area {self.area:.6g}, volume {self.volume:.6g}")
        if self.quality is not None:
            q = self.quality
            lines.append(
                f"h from {q.h_min:.4g} to {q.h_max:.4g}, angles from {q.min_angle:.1f}° to "
                f"{q.max_angle:.1f}°, chunkiness {q.chunkiness:.1f}, "
                f"area ratio {q.area_ratio:.1f}, edge ratio {q.edge_ratio:.1f}"
            )
        if self.scatter is not None:
            lines.append(str(self.scatter))
        lines += [str(finding) for finding in (*self.errors, *self.warnings)]
        n_errors, n_warnings = len(self.errors), len(self.warnings)
        if self.findings:
            verdict = "cannot be used" if n_errors else "can be used, with care"
            lines.append(f"Errors: {n_errors}, warnings: {n_warnings}. The surface {verdict}.")
        else:
            lines.append("No defects found.")
        return "\n".join(lines)
