"""The process that draws: a job as JSON on standard input, raw pictures on standard output."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from kr210_sim.film.format import Moment


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a process shall draw.

    Attributes:
        out: folder of the run.
        cameras: names; several share the picture.
        size: width and height [pixels].
        moments: cycle and time [s] of every picture.
        fine: more antialiasing and sharper shadows, for stills.
    """

    out: str
    cameras: tuple[str, ...]
    size: tuple[int, int]
    moments: list[Moment]
    fine: bool = False

    def to_json(self) -> str:
        """Return it as text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Job:
        """Read what `to_json` wrote."""
        fields = json.loads(text)
        moments = [(int(cycle), float(time)) for cycle, time in fields["moments"]]
        width, height = fields["size"]
        return cls(
            out=fields["out"],
            cameras=tuple(fields["cameras"]),
            size=(width, height),
            moments=moments,
            fine=fields["fine"],
        )


def main() -> None:
    """Draw one job; pictures are (height, width, 3) uint8, one after the other."""
    pictures = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # whatever a library prints shall not get between them
    job = Job.from_json(sys.stdin.read())
    from kr210_sim.film.painter import Painter

    with Painter(Path(job.out), cameras=job.cameras, size=job.size, fine=job.fine) as painter:
        for cycle, time in job.moments:
            rest = painter.picture(cycle, time).data.cast("B")
            while rest:
                rest = rest[pictures.write(rest) :]


if __name__ == "__main__":
    main()
