"""Where the bundled robots, scenes and texts lie, in a checkout and in an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def resource(*parts: str) -> Path:
    """Return the path of a bundled file or folder below `assets/`, `scenes/` or `docs/`.

    A wheel carries them inside the package, of `docs/` what is needed; a checkout beside it.

    Args:
        parts: path components, the first of them one of these folders.

    Raises:
        FileNotFoundError: if the installation lacks it.
    """
    for root in (_PACKAGE, _PACKAGE.parent):
        path = root.joinpath(*parts)
        if path.exists():
            return path
    raise FileNotFoundError(f"{'/'.join(parts)} is missing from this installation of kr210-sim")
