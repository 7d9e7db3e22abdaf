"""Robot description files: checks before a parser reads them, and the folders of their meshes."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from coopqp.errors import ModelError
from coopqp.reading import open_file, read_file

#: Largest accepted robot description [bytes].
MAX_DESCRIPTION_BYTES = 20_000_000
#: Largest accepted nesting depth of elements. An arm with a hundred joints needs a little more than a hundred.
MAX_NESTING = 500
#: Largest accepted number of links: Pinocchio follows chains of them recursively and would crash.
MAX_LINKS = 2000
#: Largest number of files that an MJCF includes, and of those that it names; largest size of one of these [bytes].
MAX_PARTS, MAX_NAMED, MAX_NAMED_BYTES = 100, 10_000, 100_000_000
#: Largest number of folders above a description that are searched for its meshes.
MAX_FOLDERS_ABOVE = 6
#: Elements that stand for others.
_XACRO = {f"xacro:{kind}" for kind in ("include", "macro", "if", "unless", "call")}


def description_file(path: str | Path, arm: str) -> Path:
    """The file of a robot description.

    Raises:
        ModelError: it is missing, too large, no ordinary file, or cannot be read.
    """
    try:
        file = Path(path)
    except TypeError as error:
        raise ModelError(f"arm '{arm}': {path!r} is not a path. Give the file's name.") from error
    _content(file, arm)
    return file


def _content(file: Path, arm: str) -> bytes:
    """What a description says.

    Raises:
        ModelError: it is missing, too large, no ordinary file, or cannot be read.
    """
    try:
        return read_file(file, MAX_DESCRIPTION_BYTES)
    except FileNotFoundError as error:
        raise ModelError(
            f"arm '{arm}': there is no file {error.filename}. Check the path (it is relative to {Path.cwd()})."
        ) from error
    except OSError as error:
        raise ModelError(f"arm '{arm}': cannot read {error.filename}: {error.strerror}. Check the path.") from error


def read_urdf(file: Path, arm: str) -> ElementTree.Element:
    """The root of a file that is XML with the root ``robot``, and no xacro.

    Elements that URDF does not know are left alone, as by all readers of URDF.

    Raises:
        ModelError: it is not; for a xacro the message has the command that expands it.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()  # which leaves prefixes such as xacro: alone
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    content = _content(file, arm)
    try:
        parser.Parse(content.lstrip(), True)  # white space before the XML declaration is common
        root = builder.close()
    except (expat.ExpatError, LookupError, ValueError) as error:  # also an encoding that Python does not know
        raise ModelError(f"arm '{arm}': {file} is not a readable URDF ({error}). Check the path.") from error
    if file.suffix == ".xacro" or _is_xacro(root):
        plain = file.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
        plain = plain if plain != file.name else f"expanded_{plain}"  # a shell empties the file that it writes first
        raise ModelError(
            f"arm '{arm}': {file} is a xacro, not yet a URDF. Expand it (pip install xacro): "
            f"xacro {file.name} > {plain}"
        )
    if root.tag != "robot" or not root.get("name"):
        raise ModelError(f"arm '{arm}': {file} is not a readable URDF (its root is no <robot name=…>). Check the path.")
    if len(root.findall("link")) > MAX_LINKS:
        raise ModelError(f"arm '{arm}': {file} has more than {MAX_LINKS} links and was not read.")
    return root


def _is_xacro(root: ElementTree.Element) -> bool:
    """Something has to be expanded before a URDF is there. The call of a macro that is not there is left over."""
    return any(
        element.tag in _XACRO or any("${" in value or "$(" in value for value in element.attrib.values())
        for element in root.iter()
    )


def check_mjcf(file: Path, arm: str) -> None:
    """Check a file, and what it includes, before MuJoCo reads it.

    Raises:
        ModelError: its root is another, elements are nested too deep, it declares entities, or a file that it names is
            no ordinary one.
    """
    parts, names, folders = [file], list[str](), {""}
    for part in parts:
        for tag, attributes in _elements(part, arm, is_part=part != file):
            folders |= {value for key, value in attributes.items() if tag == "compiler" and key.endswith("dir")}
            named = [value for key, value in attributes.items() if key.startswith("file") and value]
            names += named
            if tag in ("include", "model"):
                below = [place / name for name in named for place in (file.parent, part.parent)]
                parts += [found for found in dict.fromkeys(below) if found not in parts and _exists(found)]
            if max(len(parts), len(folders)) > MAX_PARTS or len(names) > MAX_NAMED:
                raise ModelError(f"arm '{arm}': {file} names too many files and was not read.")
    for name, folder in itertools.product(dict.fromkeys(names), folders):
        try:
            open_file(file.parent / folder / name, MAX_NAMED_BYTES).close()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            continue  # it is in another folder, or MuJoCo says that there is none
        except OSError as error:
            raise ModelError(
                f"arm '{arm}': {file} names {error.filename}, which cannot be read: {error.strerror}."
            ) from error


def _exists(file: Path) -> bool:
    try:
        return file.exists()
    except (OSError, ValueError):  # a name that no system has
        return False


def _elements(file: Path, arm: str, *, is_part: bool) -> list[tuple[str, dict[str, str]]]:
    """The elements of an MJCF, or of a part that another one includes. Errors as of :func:`check_mjcf`."""
    depth, found = 0, list[tuple[str, dict[str, str]]]()

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 1 and tag != "mujoco" and not is_part:  # MuJoCo reads a URDF, in another way than Arm.from_urdf
            raise ModelError(
                f"arm '{arm}': {file} is not a readable MJCF (its root is <{tag[:60]}>, not <mujoco>). Check the path."
            )
        if depth > MAX_NESTING:
            raise ModelError(f"arm '{arm}': the elements of {file} are nested more than {MAX_NESTING} deep.")
        found.append((tag, attributes))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(*declaration: object) -> None:
        raise ModelError(f"arm '{arm}': {file} declares XML entities, which are not allowed. Write their text out.")

    content, parser = _content(file, arm), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = begin, end, entity
    # If the file is not XML, MuJoCo reports it.
    with contextlib.suppress(expat.ExpatError, LookupError, ValueError):
        parser.Parse(content, True)
    return found


def mesh_folders(root: ElementTree.Element, file: Path, given: Sequence[str | Path]) -> list[str]:
    """Folders that resolve the mesh paths of a description: those given, those of packages, then the file's own.

    A package of a ``package://`` path is looked for in the folders above the description, in ``ROS_PACKAGE_PATH`` and
    below ``AMENT_PREFIX_PATH``.
    """
    folders = [str(folder) for folder in given]
    for mesh in root.iter("mesh"):
        scheme, _, rest = mesh.get("filename", "").strip().partition("package://")
        found = find_package(rest.partition("/")[0], file.parent, given) if rest and not scheme else None
        if found is not None:
            folders.append(str(found.parent))
    return list(dict.fromkeys([*folders, str(file.parent.resolve())]))


def find_package(name: str, near: Path, given: Sequence[str | Path] = ()) -> Path | None:
    """Folder of a ROS package of this name, or None."""
    above = near.resolve()
    places = [Path(folder) for folder in given]
    places += [above, *list(above.parents)[:MAX_FOLDERS_ABOVE]]
    places += [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    places += [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for place in places:
        for folder in (place / name, place):
            if folder.name == name and folder.is_dir():
                return folder
    return None
