"""What is wrong with a URDF that its parser refuses without a name: the first fault, by its joint or link."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from xml.etree import ElementTree

#: Kinds of joints; those that need a limit.
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_LIMITED = ("revolute", "prismatic")
#: Attributes that are numbers, and how many, by the element that has them.
_NUMBERS: dict[str, dict[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "velocity", "effort"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}


def urdf_fault(root: ElementTree.Element) -> str:
    """The first fault of a URDF, in words; empty if none is found."""
    return next(_faults(root), "")


def _faults(root: ElementTree.Element) -> Iterator[str]:
    links, joints = root.findall("link"), root.findall("joint")
    for kind, items in (("link", links), ("joint", joints)):
        yield from _names(kind, items)
    names, children = [link.get("name", "") for link in links], dict[str, str]()
    for joint in joints:
        where = f"joint '{joint.get('name')}'"
        kind = joint.get("type", "")
        if kind not in _KINDS:
            yield f"{where} has the type '{kind}', which is none of {', '.join(_KINDS)}"
        for end in ("parent", "child"):
            link = _attribute(joint, end, "link")
            if not link:
                yield f"{where} has no {end} link"
            elif link not in names:
                near = difflib.get_close_matches(link[:100], names, n=1)
                yield f"{where}: there is no link '{link}', its {end}{f', but one named {near[0]!r}' if near else ''}"
        child = _attribute(joint, "child", "link")
        if child and child == _attribute(joint, "parent", "link"):
            yield f"{where} joins the link '{child}' to itself"
        if child in children:
            yield f"link '{child}' is the child of two joints, '{children[child]}' and '{joint.get('name')}'"
        children[child] = joint.get("name", "")
        if kind in _LIMITED:
            for needed in ("velocity", "effort"):
                if not _attribute(joint, "limit", needed):
                    yield f"{where} needs a limit with {needed}"
        speed = _attribute(joint, "limit", "velocity")
        yield from _numbers(where, joint)
        if speed and float(speed) < 0.0:
            yield f"{where}: velocity limit {speed} is negative"
    for link_element in links:
        yield from _numbers(f"link '{link_element.get('name')}'", link_element)
    roots = [name for name in names if name not in children]
    if not roots and names:
        yield f"every link is the child of a joint, '{names[0]}' of '{children[names[0]]}': they go round in a loop"
    if len(roots) > 1:
        yield f"the links '{roots[0]}' and '{roots[1]}' are the children of no joint: only the root may be"


def _names(kind: str, items: list[ElementTree.Element]) -> Iterator[str]:
    known = set()
    for i, item in enumerate(items, start=1):
        name = item.get("name", "")
        if not name:
            yield f"{kind} number {i} of the file has no name"
        if name in known:
            yield f"two {kind}s are named '{name}'"
        known.add(name)


def _attribute(item: ElementTree.Element, tag: str, name: str) -> str:
    inner = item.find(tag)
    return "" if inner is None else inner.get(name, "").strip()


def _numbers(where: str, item: ElementTree.Element) -> Iterator[str]:
    """Attributes of a joint or link that are not the numbers that they have to be."""
    for element in item.iter():
        for name, count in _NUMBERS.get(element.tag, {}).items():
            text = element.get(name)
            if text is None:
                continue
            try:
                values = [float(word) for word in text.split()]
            except ValueError:
                values = []
            if len(values) != count or not all(map(math.isfinite, values)):
                many = "a number" if count == 1 else f"{count} numbers with spaces between"
                yield f'{where}: {element.tag} {name}="{text[:40]}" is not {many}'
