"""Names of packages and mesh files -> paths, kept inside the folders they may come from."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote

from kr210_sim.exceptions import BadInput, MissingFile

_NAME = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")
_HEAD = 65536  # [bytes] of a package.xml that are searched for its name


class Packages:
    """Finds packages as ROS would, without ROS, and resolves the file names of a description.

    A package is looked up among the folders given by name, then in `ROS_PACKAGE_PATH`, then among
    the package.xml files in the folders above the robot file and their immediate sub-folders; last,
    a folder above of just that name counts.

    A file may be read from inside a package, or from inside the robot's own folder: the nearest
    folder above the robot file with a package.xml, else the parent of the file's folder.

    Args:
        robot_file: the description.
        named: folders by package name, from `--package`.
        search: folders of packages; `ROS_PACKAGE_PATH` by default.

    Attributes:
        robot_file, named, search: as given, absolute.

    Raises:
        BadInput: if a named folder does not exist.
    """

    def __init__(
        self,
        robot_file: Path,
        named: Mapping[str, Path] | None = None,
        search: tuple[Path, ...] | None = None,
    ) -> None:
        self.robot_file = Path(os.path.abspath(robot_file))
        self.named = {name: Path(os.path.abspath(path)) for name, path in (named or {}).items()}
        for name, folder in self.named.items():
            if not os.path.isdir(folder):  # Path.is_dir raises for some impossible names
                raise BadInput(f"--package: {name}={folder} is no folder; give one that exists")
        if search is None:
            listed = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
            search = tuple(Path(os.path.abspath(entry)) for entry in listed if entry)
        self.search = search
        self._found: dict[str, Path] = {}

    @property
    def home(self) -> Path:
        """The robot's own folder."""
        for folder in self.robot_file.parents:
            if (folder / "package.xml").is_file():
                return folder
        folder = self.robot_file.parent
        return folder if folder.parent == folder.parent.parent else folder.parent

    def allow(self, folder: Path) -> None:
        """Let files come from one more folder."""
        self._found[str(folder)] = folder

    def find(self, name: str) -> Path:
        """Return the folder of a package.

        Raises:
            BadInput: if there is none, with how to name one.
        """
        if name not in self._found:
            folder = self.named.get(name) or self._in_search_path(name) or self._above(name)
            if folder is None:
                raise BadInput(
                    f"{self.robot_file.name}: package '{name}' is not found; give its folder by "
                    f"--package {name}=DIR"
                )
            self._found[name] = folder
        return self._found[name]

    def _in_search_path(self, name: str) -> Path | None:
        for entry in self.search:
            for folder in (entry, entry / name, entry / "share" / name):
                if _package_name(folder) == name:
                    return folder
            if (entry / name).is_dir():
                return entry / name
        return None

    def _above(self, name: str) -> Path | None:
        above = self.robot_file.parents
        for folder in above:
            if _package_name(folder) == name:
                return folder
            if _package_name(folder / name) == name:
                return folder / name
        return next((folder for folder in above if folder.name == name), None)

    def resolve(self, filename: str, *, where: str) -> Path:
        """Return the file that a description names.

        Args:
            filename: `package://NAME/...`, `model://NAME/...`, `file:///...` or a path relative to
                the robot file.
            where: the element that names it, for messages.

        Raises:
            BadInput: if the package or the file is missing, or the file lies outside.
        """
        scheme, _, rest = filename.partition("://")
        if not rest:
            path = self.robot_file.parent / filename
        elif scheme in ("package", "model"):
            name, _, inner = rest.partition("/")
            folder = self.find(name)
            return self.inside(folder / inner, filename, where=where, roots=(folder,))
        elif scheme == "file":
            path = Path(unquote(rest))
        else:
            raise BadInput(
                f"{where}: '{filename}' is of an unknown kind; use package://, model://, file:// "
                "or a relative path"
            )
        return self.inside(path, filename, where=where)

    def inside(
        self, path: Path, filename: str, *, where: str, roots: tuple[Path, ...] | None = None
    ) -> Path:
        """Return a path made absolute if it is a file inside the folders it may come from.

        Links are followed for the check, so that none leads outside.

        Raises:
            BadInput: otherwise.
        """
        allowed = roots or (self.home, *self.named.values(), *self.search, *self._found.values())
        plain = Path(os.path.normpath(self.robot_file.parent / path))
        try:
            real = plain.resolve()
            held = _below(plain, allowed) and _below(real, [root.resolve() for root in allowed])
            exists = real.is_file()
        except (OSError, ValueError, RuntimeError) as error:
            raise BadInput(f"{where}: '{filename}' cannot be a path ({error})") from error
        if not held:
            raise BadInput(
                f"{where}: '{filename}' leads outside of {allowed[0]}; move the file inside, or "
                "give its folder by --package NAME=DIR"
            )
        if not exists:
            raise MissingFile(f"{where}: no file '{filename}' ({plain}); correct the name")
        return plain


def _below(path: Path, roots: list[Path] | tuple[Path, ...]) -> bool:
    return any(path.is_relative_to(root) for root in roots)


def _package_name(folder: Path) -> str | None:
    """Return the name in a folder's package.xml, None without one."""
    try:
        with (folder / "package.xml").open("rb") as file:
            match = _NAME.search(file.read(_HEAD))
    except OSError:
        return None
    return match[1].decode() if match else None
